"""The moving target of each environment: a point on its world's track, at a speed over ground or through the air.

`target[env, row, 8]` = position (north, east, down, m), course (rad), its cosine and sine, its rate (rad/s), and the
speed over ground (m/s). Here one row serves all vehicles; a table in which each vehicle has a target of its own has a
row for each. The target moves on the sea, or at the flight height above it (geometry.py).

An aircraft's target moves as if it flew at a constant airspeed, by the wind triangle: velocity over ground is velocity
through the air plus wind. On a course at the angle D from where the wind blows to, with airspeed V_a and wind w, the
nose is turned into the wind by the crab angle c, and the speed over ground is v:

    sin c = (w / V_a) sin D,    v = w cos D + V_a cos c       (so |v - w| = V_a; Beard & McLain 2012, sec. 2.4)

On a path of curvature k the heading turns at v k v / (V_a cos c). The acceleration, normal to the velocity through the
air, is therefore v^2 k / cos c. It is largest straight downwind, where v = V_a + w and c = 0.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

import taichi as ti
import torch
from torch import Tensor

from rl.course.tracks import Tracks, TrackSample, track_point
from taichi_sim.air.wind import wind_factor, wind_shear
from taichi_sim.config import WorldConfig
from taichi_sim.kernels import runtime
from taichi_sim.kernels.runtime import array1, array2, array3, whole1
from taichi_sim.randomisation.conditions import bounds

NORTH, EAST, DOWN, COURSE, COS, SIN, COURSE_RATE, SPEED, SIZE = range(9)
TARGET_SPEED, INTERVAL, WIND_FACTOR, OVER_AIR = range(4)  # parameters of the kernel

POINT = 60.0  # ns of one target, about
SIGMAS = 3.0  # standard deviations of the slow variation in the strongest wind
LEAST_SHARE = 0.2  # of the airspeed, the least speed over ground; assumed: the wind must leave that much


@ti.func
def speed_over_ground(airspeed, north, east, cos, sin):
    """Speed over ground (m/s) on a course (cos, sin) at an airspeed in the wind (north, east), m/s.

    It is held at `LEAST_SHARE` of the airspeed where the wind would leave less.
    """
    along, across = cos * north + sin * east, cos * east - sin * north
    through = ti.sqrt(ti.max(airspeed * airspeed - across * across, 0.0))
    return ti.max(along + through, LEAST_SHARE * airspeed)


def crab(airspeed: float, wind: Tensor, cos: Tensor, sin: Tensor) -> Tensor:
    """Heading less course [..] (rad) that keeps to a course in the wind [.., 2] at an airspeed (m/s)."""
    north, east = wind.unbind(-1)
    across = cos * east - sin * north  # to starboard
    return -torch.asin((across * (1 / airspeed)).clamp(-1.0, 1.0))


def strongest_wind(config: WorldConfig, height: float) -> float:
    """The strongest mean wind of any realisation plus `SIGMAS` of its slow variation (m/s) at `height` (m)."""
    air = config.air
    factor = float(wind_factor(air.profile, wind_shear(air), height))
    return factor * (bounds(config, "air.speed")[1] + SIGMAS * air.std)


class Target:
    """The target of a team: live views of a table of targets, which the next step overwrites.

    Attributes:
        table: [env, row, 8], see the module; one row for all vehicles, or one for each.
        position: [env, 3] the leader's own target, NED, m.
        course, cos, sin, course_rate, speed: [env, row] columns of the table: course (rad), its cosine, sine and rate
            (rad/s), and the speed over ground (m/s).
    """

    STATE = ("table",)

    def __init__(self, table: Tensor, position: Tensor):
        """Take views of a `table` and of the leader's target."""
        self.table, self.position = table, position
        self.course, self.cos, self.sin = table[..., COURSE], table[..., COS], table[..., SIN]
        self.course_rate, self.speed = table[..., COURSE_RATE], table[..., SPEED]


TrackPack = ti.types.argpack(rows=array2, length=array1, wind=array2, numbers=array1)


@ti.kernel
def _follow(
    target: array3, progress: array1,
    env_world: ti.types.ndarray(dtype=ti.i64, ndim=1), track: TrackPack, which: whole1,
    serial: ti.template(),
):  # fmt: skip
    ti.loop_config(serialize=serial)
    for e in range(target.shape[0]):
        if which[e] != 0:
            if which[e] == 1:
                progress[e] += target[e, 0, SPEED] * track.numbers[INTERVAL]
            place = track_point(track.rows, track.length, ti.cast(env_world[e], ti.i32), progress[e])
            course, speed = place[TrackSample.COURSE], track.numbers[TARGET_SPEED]
            c, s = ti.cos(course), ti.sin(course)
            if track.numbers[OVER_AIR] > 0:
                factor = track.numbers[WIND_FACTOR]
                north, east = track.wind[e, NORTH] * factor, track.wind[e, EAST] * factor
                speed = speed_over_ground(speed, north, east, c, s)
            target[e, 0, NORTH], target[e, 0, EAST], target[e, 0, DOWN] = place[NORTH], place[EAST], 0.0
            target[e, 0, COURSE], target[e, 0, COS], target[e, 0, SIN] = course, c, s
            target[e, 0, COURSE_RATE], target[e, 0, SPEED] = place[TrackSample.CURVATURE] * speed, speed


class Targets:
    """Targets of all environments.

    Attributes:
        table: [env, 1, 8]; see the module. progress: float32 [env], m along the track; to be written at a reset.
    """

    STATE = ("table", "progress")

    def __init__(
        self, tracks: Tracks, env_world: Tensor, wind: Tensor, *, speed: float, interval: float, wind_factor: float,
        over_air: bool,
    ):  # fmt: skip
        """Move targets at `speed` (m/s) along `tracks`; `env_world` int64 [env] is the track of each environment.

        `speed` is over ground, or with `over_air` through the air. A decision takes `interval` (s). `wind` [env, 3] is
        at 10 m (m/s); `wind_factor` is the wind at the flight height over it. `env_world` and `wind` are live views.
        """
        self.table = wind.new_zeros((wind.shape[0], 1, SIZE))
        self.progress = tracks.length_m.new_zeros(wind.shape[0])
        numbers = wind.new_tensor([speed, interval, wind_factor, float(over_air)])
        self._env_world = env_world
        self._track = runtime.Packed(TrackPack, rows=tracks.rows, length=tracks.length_m, wind=wind, numbers=numbers)
        self._launch = runtime.Launcher(_follow)

    def move(self, which: Tensor, count: int) -> None:
        """Move targets of environments [env] int32: 0 not at all, 1 by an interval, 2 to `progress`.

        `count` of them are not 0: a few move on the calling thread.
        """
        serial = runtime.few(count, each=POINT)
        self._launch(self.table, self.progress, self._env_world, self._track(), which, serial)
