"""Modules that have moved: importing one by its old name raises an error that names the new place."""

import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType

ADAPTERS = {
    "gym": "gymnasium", "batched": "batched", "agents": "batched", "sb3": "sb3", "parallel": "pettingzoo",
    "skrl_env": "skrl", "marl": "marl", "others": "batched", "render": "render",
}  # fmt: skip
WITHIN = {
    "rl": "seeds>scenario",
    "rl.adapters": "agents>batched",
    "rl.course": "closed_spline>tracks traffic>obstacles",
    "rl.evaluation": "reel>record sweep>sweeps",
    "rl.evaluation.report": "sweeps>about",
    "rl.guidance": "config>residual corrected>residual steered>knowledge targets>geometry",
    "rl.guidance.controllers": (
        "course>vessel drift>vessel hull_6dof>vessel manoeuvring_3dof>vessel unity_aircraft>unity unity_boat>unity"
    ),
    "rl.learn": "history>progress joint>env perceptron>ppo",
    "rl.missions.escort": (
        "checks>worlds control>mission orbit>circling picture>tracking scouts>aircraft things>tracking"
    ),
    "rl.missions.formation": "evasions>judge flyable>worlds known>mission starts>worlds team>mission",
    "rl.missions.landing": "known>deck marker>deck starts>mission",
    "rl.perception": "camera>sightings config>contacts lookout>sightings",
    "rl.planning": "config>planner honest>planner",
    "rl.runs": "measured>folder records>folder",
    "taichi_sim": "maths>kernels replay>world",
    "taichi_sim.air": "gusts>wind",
    "taichi_sim.config": "air>world current>sea extras>base",
    "taichi_sim.film": "glyphs>picture rigs>camera shade>screen",
    "taichi_sim.hydro": "far_field>problem frequencies>compute lids>panels search>fit vehicle>hull workers>run",
    "taichi_sim.kernels": "counters>random gauss_markov>random kinematics>rotation",
    "taichi_sim.randomisation": "numbers>variation",
    "taichi_sim.recording": "meshes>bodies sea_grid>sea_patch vessel>bodies water_lines>vehicles",
    "taichi_sim.recording.ros": "build>messages motion>messages",
    "taichi_sim.sea": "sea_state>wind_sea tide>current water_column>waves",
    "taichi_sim.sea.measured": "system>record",
    "taichi_sim.sitl": "session>ardupilot",
    "taichi_sim.trials": "criteria>figures",
    "taichi_sim.uav.fixed_wing": (
        "angles>airframe commands>fixed_wing_6dof instruments>fixed_wing_6dof modes>trim numbers>params "
        "propeller>actuators"
    ),
    "taichi_sim.uav.multirotor": (
        "allocation>controller battery>rotors equations>airframe gains>controller modes>trim numbers>params "
        "power>airframe start>trim"
    ),
    "taichi_sim.usv": "manoeuvring_loads>manoeuvring_3dof mmg_loads>mmg",
    "taichi_sim.usv.hull": (
        "allocation>thruster_set damping>motion diffraction>radiation gauge>geometry instruments>motion loads>motion "
        "numbers>params pressure>water restoring>motion shapes>mesh stability>motion start>motion wave_lines>geometry"
    ),
}
"""Modules that were renamed in their package: package -> old name > new name."""
MOVED = {
    **{f"rl.{old}": f"rl.adapters.{new}" for old, new in ADAPTERS.items()},
    **{
        f"{package}.{old}": f"{package}.{new}"
        for package, renamed in WITHIN.items()
        for old, new in (each.split(">") for each in renamed.split())
    },
    "rl.evaluation.report.sources": "rl.evaluation.store",
    "rl.guidance.controllers.force_vector": "rl.guidance.controllers.unity and rl.guidance.geometry",
    "rl.perception.columns": "rl.perception.sensors (obstacles, mates), .radio, .sightings and .chart",
    "rl.perception.wind_triangle": "rl.guidance.geometry",
    "rl.planning.improvement": "rl.learn.improvement",
    "rl.processes.wires": "rl.processes",
    "rl.runs.evaluation": "rl.evaluation.episodes",
    "rl.runs.report": "rl.evaluation.report",
    "rl.runs.sweep": "rl.evaluation.sweeps",
    "rl.scene": "rl.course (tracks, obstacles, traffic) and rl.perception (all that is sensed)",
    "taichi_sim.air.exponential": "taichi_sim.kernels.fast",
    "taichi_sim.beside": "taichi_sim.commands.bundle",
    "taichi_sim.command": "taichi_sim.commands.main",
    "taichi_sim.conditions": "taichi_sim.randomisation.conditions",
    "taichi_sim.draws": "taichi_sim.randomisation.variation",
    "taichi_sim.extras": "taichi_sim.config.base",
    "taichi_sim.frontend": "taichi_sim.kernels.runtime",
    "taichi_sim.kinematics": "taichi_sim.kernels.rotation",
    "taichi_sim.packs": "taichi_sim.kernels.packs",
    "taichi_sim.plotting.style": "taichi_sim.plotting",
    "taichi_sim.plugins": "taichi_sim.config.plugins",
    "taichi_sim.recording.ros.geodesy": "taichi_sim.recording.frames",
    "taichi_sim.rigid_body": "taichi_sim.kernels.rigid_body",
    "taichi_sim.runtime": "taichi_sim.kernels.runtime",
    "taichi_sim.series": "taichi_sim.config.series",
    "taichi_sim.sitl.packets": "taichi_sim.sitl.ardupilot (Sensors, Servos and Counts: taichi_sim.sitl.craft)",
    "taichi_sim.starters": "taichi_sim.commands.starters",
    "taichi_sim.uav.fixed_wing.local_air": "taichi_sim.uav.local_air",
    "taichi_sim.usv.hull.wind": "taichi_sim.usv.vessel (Windage) and taichi_sim.usv.hull.motion",
    "taichi_sim.variation": "taichi_sim.randomisation.variation",
}


class Signpost(MetaPathFinder):
    """An import finder that comes last, for modules that no other finder has found."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Explain where the module is now.

        Raises:
            ModuleNotFoundError: if it has moved.
        """
        if fullname in MOVED:
            raise ModuleNotFoundError(f"{fullname} is now {MOVED[fullname]}", name=fullname)
        return None


def put_up() -> None:
    """Install the signpost: from now on, old names are explained."""
    if not any(isinstance(finder, Signpost) for finder in sys.meta_path):
        sys.meta_path.append(Signpost())
