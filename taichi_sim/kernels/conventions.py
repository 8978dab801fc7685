"""Frames, units, and the packing of state: the one page every other module refers to.

- World frame n: north-east-down (NED), origin at mean sea level. Body frame b: forward-right-down.
- SI units and radians. Heading psi is clockwise from north. Surface elevation zeta is up: z_n = -zeta.
- A wave direction is where the wave travels to; a wind direction is where the wind blows from.
- Quaternions are (w, x, y, z), body to world.

State of a team: `state[env, vehicle, 13]` =
position_n (3, m), quaternion_nb (4), velocity_b (3, m/s), angular_velocity_b (3, rad/s).

In f32 a position far from the origin is coarse (6 cm at 1,000 km): `remainder[env, vehicle, 3]` (m) holds what is
missing (kernels/position.py).

What the sea does to a team: `surface[env, vehicle, 2]` = elevation (m, up, the mean under the hull) and freeboard
(m, of the lowest corner of the deck above the water; models without a deck leave NO_DECK).

A sea is a table `[sea, 8, component]`, one row per quantity below, components contiguous.
"""

# state columns
POSITION = slice(0, 3)
QUATERNION = slice(3, 7)
VELOCITY = slice(7, 10)
ANGULAR_VELOCITY = slice(10, 13)
QW, QX, QY, QZ = range(3, 7)
SURGE, SWAY, HEAVE, ROLL_RATE, PITCH_RATE, YAW_RATE = range(7, 13)  # u, v, w, p, q, r
STATE_SIZE = 13
STATE_LIMIT = 1e7
"""Largest size of a number of a state (SI); beyond it a vehicle has diverged. Assumed: far above any vehicle's, and low
enough for what is computed from it to stay finite in single precision."""

# components of vectors in n (a position is a state's first columns), of vectors in b, and of Euler angles
NORTH, EAST, DOWN = 0, 1, 2
AHEAD, STARBOARD, BELOW = 0, 1, 2
HORIZONTAL = slice(0, 2)  # the two horizontal components of a vector in n or b
ROLL, PITCH, HEADING = 0, 1, 2

# surface columns
ELEVATION, FREEBOARD = 0, 1
SURFACE_SIZE = 2
NO_DECK = 1e3  # m

# sea table rows
AMPLITUDE = 0  # a, m
KX = 1  # north wavenumber, rad/m
KY = 2  # east wavenumber, rad/m
K = 3  # wavenumber, rad/m
OMEGA = 4  # angular frequency, rad/s
PHASE = 5  # phase at x = y = t = 0, rad
BX = 6  # north amplitude of horizontal displacement, a coth(k depth) kx / k, m
BY = 7  # east amplitude of horizontal displacement, m
SEA_ROWS = 8

GRAVITY = 9.81  # m/s^2, the value of every reference table (standard gravity is 9.80665)
RHO_SEA = 1025.0  # kg/m^3, sea water
