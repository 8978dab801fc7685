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
MOVED = {
    "taichi_sim.beside": "taichi_sim.commands.bundle",
    "taichi_sim.command": "taichi_sim.commands.main",
    "taichi_sim.conditions": "taichi_sim.randomisation.conditions",
    "taichi_sim.draws": "taichi_sim.randomisation.variation",
    "taichi_sim.extras": "taichi_sim.config.base",
    "taichi_sim.frontend": "taichi_sim.kernels.runtime",
    "taichi_sim.plugins": "taichi_sim.config.plugins",
    "taichi_sim.series": "taichi_sim.config.series",
    "taichi_sim.starters": "taichi_sim.commands.starters",
    "taichi_sim.variation": "taichi_sim.randomisation.variation",
    "taichi_sim.uav.fixed_wing.local_air": "taichi_sim.uav.local_air",
    "taichi_sim.recording.ros.build": "taichi_sim.recording.ros.messages",
    "taichi_sim.uav.multirotor.power": "taichi_sim.uav.multirotor.airframe",
    **{f"rl.{old}": f"rl.adapters.{new}" for old, new in ADAPTERS.items()},
    "rl.scene": "rl.course (tracks, obstacles, traffic) and rl.perception (all that is sensed)",
    "rl.guidance.corrected": "rl.guidance.residual",
    "rl.guidance.steered": "rl.guidance.knowledge",
    "rl.guidance.controllers.drift": "rl.guidance.controllers.vessel",
    "rl.learn.history": "rl.learn.progress",
    "rl.missions.formation.evasions": "rl.missions.formation.judge",
    "rl.missions.formation.known": "rl.missions.formation.mission",
    "rl.missions.escort.control": "rl.missions.escort.mission",
    "rl.missions.escort.picture": "rl.missions.escort.tracking",
    "rl.missions.escort.things": "rl.missions.escort.tracking",
    "rl.runs.measured": "rl.runs.folder",
    "rl.runs.evaluation": "rl.evaluation.episodes",
    "rl.runs.report": "rl.evaluation.report",
    "rl.runs.sweep": "rl.evaluation.sweeps",
    "rl.evaluation.sweep": "rl.evaluation.sweeps",
    "taichi_sim.maths": "taichi_sim.kernels",
    "taichi_sim.packs": "taichi_sim.kernels.packs",
    "taichi_sim.kinematics": "taichi_sim.kernels.rotation",
    "taichi_sim.rigid_body": "taichi_sim.kernels.rigid_body",
    "taichi_sim.runtime": "taichi_sim.kernels.runtime",
    "taichi_sim.air.exponential": "taichi_sim.kernels.fast",
    "taichi_sim.sea.tide": "taichi_sim.sea.current",
    "rl.seeds": "rl.scenario",
    "rl.guidance.config": "rl.guidance.residual",
    "rl.perception.config": "rl.perception.contacts",
    "rl.perception.wind_triangle": "rl.guidance.geometry",
    "taichi_sim.config.extras": "taichi_sim.config.base",
    "taichi_sim.kernels.counters": "taichi_sim.kernels.random",
    "taichi_sim.sea.sea_state": "taichi_sim.sea.wind_sea",
    "taichi_sim.kernels.kinematics": "taichi_sim.kernels.rotation",
    "taichi_sim.uav.multirotor.battery": "taichi_sim.uav.multirotor.rotors",
    "taichi_sim.usv.hull.restoring": "taichi_sim.usv.hull.motion",
    "taichi_sim.usv.hull.damping": "taichi_sim.usv.hull.motion",
    "rl.guidance.controllers.course": "rl.guidance.controllers.vessel",
    "rl.guidance.controllers.hull_6dof": "rl.guidance.controllers.vessel",
    "rl.guidance.controllers.manoeuvring_3dof": "rl.guidance.controllers.vessel",
    "rl.guidance.controllers.unity_aircraft": "rl.guidance.controllers.unity",
    "rl.guidance.controllers.unity_boat": "rl.guidance.controllers.unity",
    "rl.guidance.controllers.force_vector": "rl.guidance.controllers.unity and rl.guidance.geometry",
    "rl.guidance.targets": "rl.guidance.geometry",
    "rl.perception.columns": "rl.perception.sensors (obstacles, mates), .radio, .sightings and .chart",
    "rl.perception.lookout": "rl.perception.sightings",
    "rl.perception.camera": "rl.perception.sightings",
    "rl.course.traffic": "rl.course.obstacles",
    "rl.course.closed_spline": "rl.course.tracks",
    "rl.missions.formation.starts": "rl.missions.formation.worlds",
    "rl.missions.formation.flyable": "rl.missions.formation.worlds",
    "rl.missions.formation.team": "rl.missions.formation.mission",
    "taichi_sim.air.gusts": "taichi_sim.air.wind",
    "taichi_sim.uav.fixed_wing.modes": "taichi_sim.uav.fixed_wing.trim",
    "taichi_sim.uav.multirotor.modes": "taichi_sim.uav.multirotor.trim",
    "taichi_sim.uav.multirotor.allocation": "taichi_sim.uav.multirotor.controller",
    "taichi_sim.usv.mmg_loads": "taichi_sim.usv.mmg",
    "taichi_sim.usv.hull.loads": "taichi_sim.usv.hull.motion",
    "taichi_sim.usv.hull.numbers": "taichi_sim.usv.hull.params",
    "taichi_sim.usv.hull.diffraction": "taichi_sim.usv.hull.radiation",
    "taichi_sim.sea.measured.system": "taichi_sim.sea.measured.record",
    "taichi_sim.uav.multirotor.equations": "taichi_sim.uav.multirotor.airframe",
    "taichi_sim.uav.fixed_wing.propeller": "taichi_sim.uav.fixed_wing.actuators",
    "rl.missions.landing.starts": "rl.missions.landing.mission",
    "rl.missions.landing.known": "rl.missions.landing.deck",
    "rl.missions.landing.marker": "rl.missions.landing.deck",
    "rl.missions.escort.scouts": "rl.missions.escort.aircraft",
    "rl.missions.escort.orbit": "rl.missions.escort.circling",
    "rl.missions.escort.checks": "rl.missions.escort.worlds",
    "rl.evaluation.report.sweeps": "rl.evaluation.report.about",
    "rl.evaluation.report.sources": "rl.evaluation.store",
    "rl.adapters.agents": "rl.adapters.batched",
    "rl.runs.records": "rl.runs.folder",
    "rl.evaluation.reel": "rl.evaluation.record",
    "rl.learn.perceptron": "rl.learn.ppo",
    "rl.planning.improvement": "rl.learn.improvement",
    "rl.planning.honest": "rl.planning.planner",
    "rl.planning.config": "rl.planning.planner",
    "rl.learn.joint": "rl.learn.env",
    "rl.processes.wires": "rl.processes",
    "taichi_sim.plotting.style": "taichi_sim.plotting",
    "taichi_sim.usv.hull.pressure": "taichi_sim.usv.hull.water",
    "taichi_sim.usv.hull.allocation": "taichi_sim.usv.hull.thruster_set",
    "taichi_sim.usv.hull.shapes": "taichi_sim.usv.hull.mesh",
    "taichi_sim.usv.hull.gauge": "taichi_sim.usv.hull.geometry",
    "taichi_sim.usv.hull.wave_lines": "taichi_sim.usv.hull.geometry",
    "taichi_sim.usv.hull.stability": "taichi_sim.usv.hull.motion",
    "taichi_sim.usv.hull.start": "taichi_sim.usv.hull.motion",
    "taichi_sim.usv.hull.instruments": "taichi_sim.usv.hull.motion",
    "taichi_sim.usv.hull.wind": "taichi_sim.usv.vessel (Windage) and taichi_sim.usv.hull.motion",
    "taichi_sim.usv.manoeuvring_loads": "taichi_sim.usv.manoeuvring_3dof",
    "taichi_sim.uav.fixed_wing.numbers": "taichi_sim.uav.fixed_wing.params",
    "taichi_sim.uav.multirotor.numbers": "taichi_sim.uav.multirotor.params",
    "taichi_sim.uav.fixed_wing.angles": "taichi_sim.uav.fixed_wing.airframe",
    "taichi_sim.uav.multirotor.start": "taichi_sim.uav.multirotor.trim",
    "taichi_sim.uav.multirotor.gains": "taichi_sim.uav.multirotor.controller",
    "taichi_sim.sea.water_column": "taichi_sim.sea.waves",
    "taichi_sim.kernels.gauss_markov": "taichi_sim.kernels.random",
    "taichi_sim.randomisation.numbers": "taichi_sim.randomisation.variation",
    "taichi_sim.config.current": "taichi_sim.config.sea",
    "taichi_sim.config.air": "taichi_sim.config.world",
    "taichi_sim.replay": "taichi_sim.world",
    "taichi_sim.uav.fixed_wing.commands": "taichi_sim.uav.fixed_wing.fixed_wing_6dof",
    "taichi_sim.uav.fixed_wing.instruments": "taichi_sim.uav.fixed_wing.fixed_wing_6dof",
    "taichi_sim.hydro.search": "taichi_sim.hydro.fit",
    "taichi_sim.hydro.vehicle": "taichi_sim.hydro.hull",
    "taichi_sim.hydro.lids": "taichi_sim.hydro.panels",
    "taichi_sim.hydro.frequencies": "taichi_sim.hydro.compute",
    "taichi_sim.hydro.workers": "taichi_sim.hydro.run",
    "taichi_sim.film.rigs": "taichi_sim.film.camera",
    "taichi_sim.film.shade": "taichi_sim.film.screen",
    "taichi_sim.film.glyphs": "taichi_sim.film.picture",
    "taichi_sim.trials.criteria": "taichi_sim.trials.figures",
    "taichi_sim.recording.sea_grid": "taichi_sim.recording.sea_patch",
    "taichi_sim.recording.water_lines": "taichi_sim.recording.vehicles",
    "taichi_sim.recording.meshes": "taichi_sim.recording.bodies",
    "taichi_sim.recording.vessel": "taichi_sim.recording.bodies",
    "taichi_sim.recording.ros.motion": "taichi_sim.recording.ros.messages",
    "taichi_sim.recording.ros.geodesy": "taichi_sim.recording.frames",
    "taichi_sim.sitl.packets": "taichi_sim.sitl.ardupilot (Sensors, Servos and Counts: taichi_sim.sitl.craft)",
    "taichi_sim.sitl.session": "taichi_sim.sitl.ardupilot",
    "taichi_sim.hydro.far_field": "taichi_sim.hydro.problem",
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
