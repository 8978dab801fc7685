"""What is near the vessels of a team that has charts: team mates as tracked (tracked_objects.py), charted obstacles.

A chart (chart.py) holds what all have sighted. Frame: NED.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

import taichi as ti
from torch import Tensor

from rl.perception.chart import AGE, EAST, NORTH, P_PP, V_EAST, V_NORTH, Chart
from rl.perception.radio import NEVER
from rl.perception.sensors import Nearby, Sight, insert, store_obstacle
from rl.perception.sightings import Object
from rl.perception.tracked_objects import ObjectsConfig, TrackedObjects
from rl.step import NOT_DUE, Due
from taichi_sim.fleet import Views
from taichi_sim.kernels import runtime
from taichi_sim.kernels.runtime import array1, array3, array4, whole1

VAGUE = 8.0  # m, standard deviation of a place: objects known less well are not evaded; assumed

REACH, DOUBT, FIRST = range(3)  # limits: of sensors, m; variance, m^2; number of the first vehicle on the chart

ChartedPack = ti.types.argpack(obstacles=array4, signals=array3)
FromPack = ti.types.argpack(tracked=array4, objects=array3, state=array3, derived=array3, limits=array1)


@ti.kernel
def _nearest(out: ChartedPack, of: FromPack, which: whole1, sight: ti.template()):
    ti.loop_config(serialize=runtime.loop.serial)
    for e, i in ti.ndrange(of.state.shape[0], of.state.shape[1]):
        if which[e] != NOT_DUE:
            reach, vague, own = of.limits[REACH], of.limits[DOUBT], ti.cast(of.limits[FIRST], ti.i32) + i
            place = ti.Vector([of.state[e, i, a] for a in ti.static(range(3))])
            count = ti.static(sight.obstacles)
            distance = ti.Vector([reach] * ti.static(count + 1))
            index = ti.Vector([-1] * ti.static(count + 1))
            for k in range(of.tracked.shape[2]):
                if of.tracked[e, own, k, AGE] < NEVER and of.tracked[e, own, k, P_PP] < vague:
                    dx, dy = of.tracked[e, own, k, NORTH] - place[0], of.tracked[e, own, k, EAST] - place[1]
                    d = ti.sqrt(dx * dx + dy * dy) - of.objects[e, k, Object.RADIUS]
                    distance, index = insert(distance, index, d, k, count)
            for k in ti.static(range(sight.obstacles)):
                m = ti.max(index[k], 0)
                there = ti.Vector([of.tracked[e, own, m, NORTH], of.tracked[e, own, m, EAST],
                                   of.objects[e, m, Object.RADIUS], of.tracked[e, own, m, V_NORTH],
                                   of.tracked[e, own, m, V_EAST]])  # fmt: skip
                store_obstacle(out, of.derived, sight, e, i, k, distance[k], index[k], place, there, reach)


class ChartedObjects(TrackedObjects):
    """Contacts of one team of vessels that have a chart: obstacles are the nearest charted objects."""

    def __init__(
        self, config: ObjectsConfig, sensor: Nearby, fleet: Views, own: Views, interval: float, vehicles: int, *,
        chart: Chart, first: int, objects: Tensor,
    ):  # fmt: skip
        """Measure as `TrackedObjects` do, and read `chart`.

        Args:
            first: number of the team's first vehicle on the chart. objects: [env, object, 6] radius (m) in the last
                column.
        """
        super().__init__(config, sensor, fleet, own, interval, vehicles)
        self._charted = runtime.Packed(
            FromPack, tracked=chart.tracks, objects=objects, state=own.state, derived=own.derived,
            limits=own.state.new_tensor([self.reach, VAGUE * VAGUE, first]),
        )  # fmt: skip
        self._nearest = runtime.Packed(ChartedPack, obstacles=self.obstacles, signals=self.written)
        self._sight = Sight(self.num_obstacles, self.num_mates, self.axes)
        self._find = runtime.Launcher(_nearest, few=runtime.MEDIUM)

    def update(self, due: Due) -> None:
        """Measure, and read the chart, in the environments that are `due`."""
        super().update(due)
        self._find(self._nearest(), self._charted(), due.which, self._sight, envs=due.count)
