"""Vehicle file of a hull that was given as a mesh: added mass, resistance, damping, thrusters, windage, offsets.

Every number has a line with its source. What nobody gave is assumed, and the line says so and how much it matters.

- Added mass: surge, sway and yaw in the limit omega -> 0, because manoeuvres are slow; heave, roll and pitch at their
  resonances, where they oscillate. Near a resonance of water between two hulls the latter may be negative or many times
  as large; then they are those of infinite frequency.
- Surge resistance: resistance.py, as a u + b u^2 up to the top speed.
- Cross-flow drag: Hoerner (1965) along each hull. Lift: the linear derivatives of Clarke, Gedling and Hine (1983, The
  application of manoeuvring criteria in hull design using linear theory, Trans. RINA 125) for each hull, less what
  Coriolis and Munk loads of the added mass already hold. They are of ships with a stern as deep as the hull; lift goes
  with the square of the draught where the flow leaves (slender bodies: Newman 1977, Marine Hydrodynamics, sec. 7.8).
- Heave, roll, pitch: radiation at the resonance; in roll also viscosity: roll_damping.py for hulls in its range, else a
  share of the critical damping.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.applications.hydro.hull_input import FloatingHull
from taichi_sim.applications.hydro.resistance import FASTEST, HullForm, Race, Resistance, cross_flow_coefficient
from taichi_sim.applications.hydro.roll_damping import Rolling
from taichi_sim.config import ConfigError
from taichi_sim.models.usv.hull.database import SUFFIX
from taichi_sim.models.usv.hull.params import COUPLED, AddedCoupling

Array = NDArray[np.float64]
OSCILLATING = [2, 4]  # modes whose added mass is that at their resonance (A44 alone, too); of others, omega -> 0
NEAR_INF = (0.5, 2.0)  # allowed A(resonance) / A(infinity) of these; assumed
TINY = 1e-12  # avoids a division by zero
SYMMETRIC = 0.1  # allowed asymmetry of a computed added mass, from coarse panels; assumed
STRIPS = (0.5, 2.2)  # allowed sway added mass over rho pi T^2 / 2 of each section (half ellipses); assumed
ROLL = 0.04  # viscous share of critical roll damping of hulls outside the range of roll_damping.py; assumed
PLAUSIBLE_FROUDE = 0.4  # Froude number of the top speed of a boat whose thrusters are not given; assumed
ASTERN = 0.6  # thrust astern over thrust ahead; assumed
DISC = 4000.0  # N/m^2, thrust at rest over the square of the diameter; assumed: small boats have 1500 to 9000
LIFT_UNITS = ("kg/m", "kg", "kg", "kg m")
SHAFT = 100.0  # rad/s, highest shaft speed; assumed
LAG = 0.2  # s, of thrusters; assumed
TURN_RATE = 90.0  # deg/s, of azimuth thrusters; assumed
OUTBOARD = 0.45  # distance of assumed propellers behind CO, over the length


UNFINISHED = "UNFINISHED"  # mark of a file whose database is not there yet
RADIATION = {
    "memory": 'radiation = "memory"  # and diffraction, of the database\ndatabase = "{name}' + SUFFIX + '"',
    "constant": f'radiation = "constant"  # {UNFINISHED}: coarse panels, no database yet; run the command above again',
    "constant, as asked": 'radiation = "constant"  # added mass and damping below: for calm water (--only-vehicle)',
    "constant, no memory fits": 'radiation = "constant"  # added mass and damping below; no memory fitted the database',
}


class Thruster(NamedTuple):
    """A thruster as the user gives it."""

    x: float  # m ahead of CO
    y: float  # m to starboard
    z: float  # m down
    thrust: float  # N, largest ahead


class Given(NamedTuple):
    """What a mesh does not tell."""

    thrusters: tuple[Thruster, ...] = ()
    azimuth: bool = False
    propeller: float | None = None  # m, diameter of each; 0: the thrust does not fall with speed
    windage: tuple[float, float, float] | None = None  # m^2 ahead, m^2 to the side, m: centre above the water


class Flow(NamedTuple):
    """Results of potential theory about CO in the vehicle's frame."""

    slow: Array  # [6, 6] added mass, omega -> 0
    endless: Array  # [6, 6] added mass, omega -> infinity
    omega: Array  # [n] rad/s
    added_mass: Array  # [n, 6, 6]
    damping: Array  # [n, 6, 6]
    resonances: dict[int, float]  # rad/s, by mode

    def at(self, table: Array, i: int, j: int) -> float:
        """Entry of A or B [n, 6, 6] at the resonance of the mode j, or of heave if it has none."""
        return float(np.interp(self.resonances.get(j, self.resonances[2]), self.omega, table[:, i, j]))


def added_mass(flow: Flow, form: HullForm, rho: float, name: str) -> tuple[Array, list[str]]:
    """Added mass [6, 6] for manoeuvring, and messages."""
    A, told = flow.slow.copy(), []
    d = np.sqrt(np.abs(np.diag(A)))
    off = float((np.abs(A - A.T) / np.maximum(np.outer(d, d), TINY)).max())
    fast = np.array([[flow.at(flow.added_mass, i, j) for j in range(6)] for i in range(6)])
    near = np.diag(fast)[OSCILLATING] / np.diag(flow.endless)[OSCILLATING]
    if (near < NEAR_INF[0]).any() or (near > NEAR_INF[1]).any():
        told.append(
            f"added mass of heave and pitch at their resonances is {near[0]:.2g} and {near[1]:.2g} times that of "
            "infinite frequency (water between hulls resonates near, or panels are coarse): the latter is taken"
        )
        fast = flow.endless
    A[OSCILLATING] = fast[OSCILLATING]
    A[:, OSCILLATING] = fast[:, OSCILLATING]
    roll, endless = flow.at(flow.added_mass, 3, 3), float(flow.endless[3, 3])
    A[3, 3] = roll if NEAR_INF[0] < roll / endless < NEAR_INF[1] else endless
    kept = np.eye(6, dtype=bool)
    for i, j in COUPLED:
        kept[i, j] = kept[j, i] = True
    A = np.where(kept, (A + A.T) / 2, 0.0)
    if off > SYMMETRIC or np.linalg.eigvalsh(A)[0] <= 0:
        cause = "is not symmetric" if off > SYMMETRIC else "is not positive definite"
        raise ConfigError(f"{name}: its added mass {cause}: the panels are too coarse or too uneven; raise --panels")
    strips = form.hulls * rho * np.pi / 2 * form.lateral**2 / form.length
    ratio = A[1, 1] / strips
    if not STRIPS[0] <= ratio <= STRIPS[1]:
        told.append(
            f"warning: sway added mass is {A[1, 1]:.4g} kg, {ratio:.2g} times that of strips (rho pi T^2 / 2 per m: "
            f"{strips:.4g} kg; {STRIPS[0]:g} to {STRIPS[1]:g} are usual): check --unit, --waterline, or raise --panels"
        )
    return A, told


def lift(form: HullForm, A: Array, rho: float) -> dict[str, float]:
    """Lift (params.Lift) of all hulls: derivatives of Clarke et al. (1983) less those of the ideal fluid.

    Derivatives are over 1/2 rho L^2 (Y_v), L^3 (Y_r, N_v), L^4 (N_r) and u. N_uv, the least certain, is limited so that
    they take energy.
    """
    L, B, T = form.length, form.beam, form.draught
    C_B, scale = form.volume / (L * B * T), -form.hulls * rho / 2 * np.pi * T**2
    Y_uv = scale * (1 + 0.40 * C_B * B / T)
    Y_ur = scale * L * (-0.5 + 2.2 * B / L - 0.080 * B / T) + A[0, 0]
    N_uv = scale * L * (0.5 + 2.4 * T / L) + A[1, 1] - A[0, 0]
    N_ur = scale * L**2 * (0.25 + 0.039 * B / T - 0.56 * B / L) + A[1, 5]
    most = 0.999 * 2 * np.sqrt(Y_uv * N_ur)
    N_uv = float(np.clip(N_uv, -most - Y_ur, most - Y_ur))
    stern = (form.stern_draught / T) ** 2
    return {"Y_uv": stern * Y_uv, "Y_ur": stern * Y_ur, "N_uv": stern * N_uv, "N_ur": stern * N_ur}


def vehicle_text(
    craft: FloatingHull, form: HullForm, flow: Flow, stiffness: Array, given: Given, rho: float, g: float,
    radiation: str, command: str,
) -> tuple[str, list[str]]:  # fmt: skip
    """The TOML of a whole vehicle, and messages.

    `radiation` is one of RADIATION; `stiffness` [6, 6] is about CO, at the design waterline.
    """
    assert craft.shape is not None
    A, told = added_mass(flow, form, rho, craft.name)
    whole = form.surface.whole.reshape(-1, 3)
    length, beam, draught = np.ptp(whole[:, 0]), np.ptp(whole[:, 1]), -whole[:, 2].min()
    freeboard = -float(craft.shape.points[0, -1, 2])
    resistance = Resistance(form, rho, g)
    thrusters, actions, top, resistance = _thrusters(craft, form, resistance, given, told)
    a, b, error = resistance.fitted(top)
    parts = {name: f"{value:.3g}" for name, value in resistance.parts(top).items()}
    waves = "Holtrop and Mennen (1982; 1984)" if resistance.by_regression else "Michell's thin-ship theory (1898)"
    off = ", ".join(form.outside)
    outside = f"; outside its range\n# ({off}), so assumed: some 10 % of this part" if off else ""
    critical = 2 * np.sqrt(max(stiffness[3, 3], 0.0) * (craft.M[3, 3] + A[3, 3]))
    linear = np.array([a, 0.0, *(max(flow.at(flow.damping, mode, mode), 0.0) for mode in (2, 3, 4)), 0.0])
    viscous, eddies, roll = _viscous_roll(form, craft, flow.resonances[3], critical, rho)
    linear[3] += viscous
    mean_draught = form.lateral / form.length
    C_d = cross_flow_coefficient(form.beam / (2 * form.draught))
    frontal, lateral, height = given.windage or (beam * freeboard, length * freeboard, freeboard / 2)
    areas = "as given" if given.windage else (
        "assumed: the sides above water alone; loads go with the areas, so give --windage"
    )  # fmt: skip
    x, y, z = craft.cg
    moved = craft.mass * np.array([y * y + z * z, x * x + z * z, x * x + y * y])  # moments of the CG's distance from CO
    gyration = np.sqrt((np.diag(craft.M)[3:] - moved) / craft.mass)
    gyration_note = "; assumed: periods of roll and pitch go with it" if "gyration" in craft.assumed else ""
    rows = "\n".join(
        f"  [{x:g}, [{', '.join(f'[{y:g}, {z:g}]' for y, z in section)}]]," for x, section in craft.shape.stations
    )
    coupling = ", ".join(
        f"{name} = {A[i, j]:.5g}" for name, (i, j) in zip(AddedCoupling.model_fields, COUPLED, strict=True)
    )
    lifted = zip(lift(form, A, rho).items(), LIFT_UNITS, strict=True)
    lifts = "\n".join(f"{name} = {value:.5g}  # {unit}" for (name, value), unit in lifted)
    text = f'''# {craft.name}: made of a mesh by
#   {command}
# What is assumed says so, with what it matters; put in measured numbers where you have them (docs/fit.md: from a log).
model = "hull_6dof"
length = {length:.6g}  # m, below water
beam = {beam:.6g}  # m, below water
height = {draught + freeboard:.6g}  # m, keel to deck
collision_radius = {np.hypot(length, beam) / 2:.6g}  # m, half the diagonal
restoring = "panels"
actions = "{actions}"

[rigid_body]
mass = {craft.mass:.9g}  # kg
cg = {_row(craft.cg)}  # m
gyration = {_row(gyration)}  # m{gyration_note}

[hydrodynamics]
{RADIATION[radiation].format(name=craft.name)}
# For Coriolis and Munk loads. Potential theory: surge, sway, yaw and coupling in the limit of slow motion; heave, roll,
# pitch at their resonances ({flow.resonances[2]:.3g}, {flow.resonances[3]:.3g} and {flow.resonances[4]:.3g} rad/s)
added_mass = {_row(np.diag(A))}  # kg, kg m^2
added_coupling = {{ {coupling} }}  # kg m, kg m^2
# Surge at {top:.3g} m/s, fitted below it within {100 * error:.2g} % of that (top speed goes with its square root):
# {parts["friction"]} N of friction: ITTC (1957), with 1 + k = {form.form_factor:.3g} of Holtrop (1984){outside}
# {parts["waves"]} N of waves: {waves}
# {parts["transom"]} N of the transom: Holtrop (1984); appendages and fouling: 0, assumed (some per cent)
# {_lost(resistance, top, given.propeller)}
# Heave, roll, pitch: radiation at the resonance. Sway and yaw: cross-flow drag and lift. Roll also:
# {roll}
linear = {_row(linear)}  # N s/m, N m s
quadratic = {_row([b, 0.0, 0.0, eddies, 0.0, 0.0])}  # N s^2/m^2, N m s^2
# Hoerner (1965) at B / 2T = {form.beam / (2 * form.draught):.3g} of {_count(form)}, over the mean draught{_shade(form)}
cross_flow_length = {form.length:.6g}  # m
cross_flow_draft = {mean_draught:.6g}  # m
cross_flow_coefficient = {form.hulls * C_d:.6g}{"" if form.hulls == 1 else "  # of both hulls"}

[hydrodynamics.lift]
# Clarke, Gedling and Hine (1983), of {_count(form)}, less Munk and Coriolis loads, times the square of stern draught
# {form.stern_draught:.3g} m over draught (slender bodies: Newman 1977){_clarke(form)}
{lifts}

{thrusters}
[windage]  # coefficients: Fossen (2021), sec. 10.1; areas {areas}
frontal_area = {frontal:.4g}  # m^2
lateral_area = {lateral:.4g}  # m^2
height = {height:.4g}  # m

# x, then y, z (down) from the keel to the deck edge, m
[hull]
shape = "stations"
stations = [
{rows}
]
'''
    return text, told


def _viscous_roll(
    form: HullForm, craft: FloatingHull, omega: float, critical: float, rho: float
) -> tuple[float, float, str]:
    """Viscous roll damping at the resonance `omega`: linear (N m s), quadratic (N m s^2), and its source."""
    one = Rolling.of(form, craft.cg[2])
    outside = ["two hulls"] if form.hulls > 1 else one.outside
    if not outside:
        return one.friction(rho, omega), one.eddies(rho), (
            "friction and eddies of a bare hull at rest: Kawahara, Maekawa and Ikeda (2009); bilge keels and speed add"
        )  # fmt: skip
    return ROLL * critical, 0.0, (
        f"{100 * ROLL:g} % of critical damping: assumed, it sets the height of the roll resonance alone; outside the\n"
        f"# range of Kawahara, Maekawa and Ikeda (2009): {', '.join(outside)}"
    )  # fmt: skip


def _count(form: HullForm) -> str:
    return "one hull" if form.hulls == 1 else "each of two hulls"


def _shade(form: HullForm) -> str:
    if form.hulls == 1:
        return ""
    return ";\n# the lee of one hull is left out: assumed, half the drag at worst, where the boat drifts broadside"


def _clarke(form: HullForm) -> str:
    ratio = form.beam / form.draught
    if form.hulls == 1 and 2.0 <= ratio <= 5.0:
        return ""
    return (
        f";\n# ships' regression, here for B / T = {ratio:.3g}: assumed, and it decides on course stability: turning "
        "circle and overshoot\n# change by some 10 % per 10 % of it"
    )


def _thrusters(
    craft: FloatingHull, form: HullForm, resistance: Resistance, given: Given, told: list[str]
) -> tuple[str, str, float, Resistance]:
    """Sections of the thrusters, their actions, the top speed (m/s), and the resistance with the thrust lost."""
    units, note = given.thrusters, ""
    if not units:
        u = PLAUSIBLE_FROUDE * float(np.sqrt(resistance.g * form.length))
        each = float(f"{resistance.total(u) / 2:.3g}")
        y = form.apart or form.beam / 4
        units = tuple(Thruster(-OUTBOARD * form.length, side * y, form.draught / 2, each) for side in (-1, 1))
        note = (
            f"# Nobody gave thrusters (--thruster X Y Z N): assumed are two propellers that make {u:.3g} m/s. Top\n"
            "# speed goes with the square root of their thrust, turning with thrust times distance from y = 0\n"
        )
        told.append(
            f"{craft.name}: no --thruster: assumed are two propellers of {each:g} N at y = {-y:.3g} and {y:.3g} m, for "
            f"{u:.3g} m/s; top speed goes with the square root of their thrust, the yaw moment with thrust times y"
        )
    thrust = sum(unit.thrust for unit in units)
    if given.thrusters:  # those assumed are sized for their speed
        resistance = replace(resistance, races=_races(units, given.propeller, resistance.rho))
    top = resistance.speed(thrust)
    if top >= FASTEST * np.sqrt(resistance.g * form.length) * (1 - 1e-9):
        told.append(
            f"warning: {thrust:g} N are more than the resistance at a Froude number of {FASTEST:g}, where hulls plane: "
            "check the thrust (N)"
        )
    other = units[0]._replace(y=-units[0].y)
    if len(units) == 2 and not given.azimuth and other == units[1] and other.y != 0:
        left, right = sorted(units, key=lambda unit: unit.y)
        text = f"""{note}[thrusters]
left = {_row(left[:3])}  # m
right = {_row(right[:3])}  # m
# {left.thrust:.6g} N at n_max: assumed shaft speeds, which nothing else hangs on
k_positive = {left.thrust / SHAFT**2:.6g}  # N s^2
k_negative = {ASTERN * left.thrust / SHAFT**2:.6g}  # N s^2; assumed {ASTERN:g} of that ahead: for stopping
n_max = {SHAFT:g}  # rad/s
n_min = {-SHAFT:g}  # rad/s
lag = {LAG:g}  # s; assumed: it matters for control faster than some 1 / lag
"""
        return text, "surge_yaw", top, resistance
    sections = []
    for k, unit in enumerate(units, 1):
        turn = (
            f"turn_rate_deg = {TURN_RATE:g}  # deg/s; assumed: half a turn in {180 / TURN_RATE:g} s\n"
            if given.azimuth else ""
        )  # fmt: skip
        sections.append(
            f"[actuators.unit_{k}]\nposition = {_row(unit[:3])}  # m\nthrust_max = {unit.thrust:.6g}  # N\n"
            f"thrust_min = {-ASTERN * unit.thrust:.6g}  # N; assumed {ASTERN:g} of that ahead\n"
            f"lag = {LAG:g}  # s; assumed: it matters for control faster than some 1 / lag\n{turn}"
        )
    return note + "\n".join(sections), "wrench" if given.azimuth else "units", top, resistance


def _races(units: tuple[Thruster, ...], propeller: float | None, rho: float) -> tuple[Race, ...]:
    """Races of the propellers, of a diameter (m) or of the assumed DISC."""
    if propeller == 0:
        return ()
    loads = [DISC if propeller is None else unit.thrust / propeller**2 for unit in units]
    return tuple(
        Race(unit.thrust, float(np.sqrt(8 * load / (np.pi * rho)))) for unit, load in zip(units, loads, strict=True)
    )


def _lost(resistance: Resistance, top: float, propeller: float | None) -> str:
    """The line on thrust that falls with speed."""
    if not resistance.races:
        return "no thrust is lost with speed" + (", as given" if propeller == 0 else ": it is sized for this speed")
    disc = f"propellers of {propeller:g} m" if propeller else f"T / D^2 = {DISC:g} N/m^2, assumed (--propeller)"
    return f"{resistance.lost(top):.3g} N of thrust lost with speed: momentum theory at constant power, {disc}"


def _row(values) -> str:
    return "[" + ", ".join(f"{float(v):.6g}" if v else "0.0" for v in values).replace("e+", "e") + "]"
