"""Judge a run's policies and classical controllers in another simulator, on the same episodes and with the same
figures.

    git clone https://github.com/cybergalactic/PythonVehicleSimulator
    python tools/transfer.py RUN --path PythonVehicleSimulator      # its Otter
    pip install rotorpy jsbsim crazyflow
    python tools/transfer.py RUN --team uav --simulator rotorpy     # any multirotor of four rotors
    python tools/transfer.py RUN --team uav --simulator crazyflow   # its Holybro X500, in the place of the x500
    python tools/transfer.py aerosonde --simulator jsbsim           # its Cessna 172P, in the place of a fixed wing
    python tools/transfer.py RUN --simulator mymodule:Class --controller classical --episodes 16

RUN is a run folder of rl/train.py. For the classical controllers a scenario will do: a file, or a shipped one's name.
Worlds, targets, sensors, radio, controllers and judge are ours. In each decision the other simulator moves the team's
vehicles instead of our model. Both move in calm water without wind, in the scenario's current; [TEAM.vary] is ignored.
Which numbers the vehicles have there, their classes say (tools/simulators). A simulator of your own derives from
`tools.simulators.Simulator`. crazyflow asks for the setting SCIPY_ARRAY_API=1.

It prints a Markdown table: each figure there / here, and the ratio (for shares the difference, in points) with its 95 %
interval.
"""

import argparse
import contextlib
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

if __package__ in (None, ""):  # run as a script: the packages are beside this file's folder
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from rl.mission import Mission
from taichi_sim.config import ConfigError
from taichi_sim.config.plugins import load_class
from taichi_sim.fleet import Fleet
from taichi_sim.kernels.conventions import POSITION, STATE_SIZE
from taichi_sim.options import positive_int, seed
from taichi_sim.surroundings.around_vehicles import Surroundings
from tools.simulators import SIMULATORS, Array, Simulator

EPISODES = 64


@contextlib.contextmanager
def in_place(mission: Mission, team: str, kind: type[Simulator], path: Path | None) -> Iterator[None]:
    """Let a simulator move a team of `mission` inside this context."""
    fleet = mission.teams[team].fleet
    simulator = kind(fleet.model, path)

    def step(fleet: Fleet, around: Surroundings) -> None:
        moved, rows = np.asarray(simulator.advance(fleet, around)), fleet.num_envs * fleet.count
        if moved.shape != (rows, STATE_SIZE):
            raise ConfigError(f"{kind.__name__}.advance gave {list(moved.shape)}, expected [{rows}, {STATE_SIZE}]")
        given = torch.from_numpy(moved).view(fleet.state.shape)
        fleet.state.copy_(given)
        fleet.remainder.copy_(given[..., POSITION] - fleet.position_n)
        fleet.update()

    fleet.model.step = step
    try:
        yield
    finally:
        del fleet.model.step  # the class's method takes over again; missions may share a model


def parser() -> argparse.ArgumentParser:
    """The arguments."""
    from rl.commands import shared

    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("run", type=Path, metavar="RUN", help="run folder of rl/train.py, or a scenario (classical alone)")
    p.add_argument("--team", default=None, help="team that is moved there (default: the first that was trained)")
    p.add_argument("--simulator", default="python_vehicle_simulator", metavar="NAME",
                   help=f"{', '.join(SIMULATORS)}, or module:Class of your own (default: %(default)s)")  # fmt: skip
    p.add_argument("--path", type=Path, default=None, metavar="DIR",
                   help="folder of the simulator, if it is not installed")  # fmt: skip
    p.add_argument("--controller", choices=("policy", "classical"), action="append", default=None,
                   help="may be given twice (default: both; of a scenario: classical)")  # fmt: skip
    p.add_argument("--episodes", type=positive_int, default=EPISODES, help=f"default: {EPISODES}; at most 256")
    p.add_argument("--seed", type=seed, default=None, help="of the unseen worlds (default: the scenario's)")
    shared.add_common(p)
    return p


def main(argv: list[str] | None = None) -> None:
    """Run the command."""
    args = parser().parse_args(argv)
    from rl.commands import shared
    from rl.evaluation.episodes import CHUNK, check_measurable, mission_class
    from rl.learn.policy import policies_of
    from rl.runs.folder import load_config

    scenario = None if args.run.is_dir() else args.run
    controllers = args.controller or ("classical",) if scenario else args.controller or ("policy", "classical")
    if scenario and "policy" in controllers:
        raise ConfigError(f"--controller policy needs a run folder, and {args.run} is none")
    config, _ = load_config(args.run, args.overrides, scenario)
    team = args.team or config.trained[0]
    if team not in config.trained:
        raise ConfigError(f"--team {team}: allowed are {', '.join(config.trained)}")
    if args.episodes > CHUNK:
        raise ConfigError(f"--episodes {args.episodes}: at most {CHUNK}")
    calm = ("sea.sea_state=0", "air.speed=0", "air.std=0", 'air.turbulence="none"', f"{team}.vary={{}}")
    config, source = load_config(args.run, [*args.overrides, *calm], scenario)
    check_measurable(config)
    kind = SIMULATORS.get(args.simulator)
    if kind is None:
        if ":" not in args.simulator:
            raise ConfigError(f"--simulator {args.simulator}: {', '.join(SIMULATORS)}, or module:Class")
        kind = load_class(args.simulator, Simulator, [Path.cwd()])
    shared.start(args)
    seed, rows = config.evaluation.seed if args.seed is None else args.seed, {}
    for controller in controllers:
        policy = policies_of(controller, args.run, config)[team]
        rows[controller] = [
            judged(config, source, team, policy, args.episodes, seed, other, args.path) for other in (kind, None)
        ]
    print(table(mission_class(config, source).Judge, rows, args.episodes))


def judged(
    config: Any, source: Path, team: str, policy: Any, episodes: int, seed: int, kind: type[Simulator] | None,
    path: Path | None,
) -> dict[str, Array]:  # fmt: skip
    """Judge `policy` while a simulator of `kind` moves the vehicles (None: ours); return numbers of each episode."""
    from rl.evaluation.episodes import one_episode_each, run_episodes
    from taichi_sim.kernels import runtime

    mission = one_episode_each(config, (team,), episodes, seed, source)
    moved = contextlib.nullcontext() if kind is None else in_place(mission, team, kind, path)
    with moved, runtime.torch_at_rest():
        judge = run_episodes(mission, {team: policy})[team]
    return type(judge).episodes([judge], config)


def table(judge: Any, rows: Mapping[str, list[dict[str, Array]]], episodes: int) -> str:
    """Markdown: a row for each figure, a column for each controller."""
    from tools.compare import cell

    lines = [f"| {episodes} episodes: there / here | " + " | ".join(rows) + " |", "|---" * (1 + len(rows)) + "|"]
    for key in judge.plotted:
        lines.append(f"| {key} | " + " | ".join(cell(key, judge, *pair, 1) for pair in rows.values()) + " |")
    return "\n".join(lines)


if __name__ == "__main__":
    from rl.commands.shared import run

    sys.exit(run(main))
