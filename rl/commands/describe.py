"""What the policies of a scenario or of a task of the benchmark take and give: names, order, units, rates."""

import argparse
import json

from rl.commands import shared


def parser() -> argparse.ArgumentParser:
    """The arguments."""
    p = argparse.ArgumentParser(description=__doc__)
    p.add_argument("what", metavar="TASK|SCENARIO", help="a task (taichi-sim score --help), or a scenario")
    p.add_argument("--json", action="store_true", help="print JSON")
    shared.add_common(p)
    return p


def main(argv: list[str] | None = None) -> None:
    """Run the command."""
    args = parser().parse_args(argv)
    from rl.evaluation.benchmark import read_tasks
    from rl.evaluation.episodes import mission_class
    from rl.learn.policy_interface import interface_of, told
    from rl.missions import load_scenario, make_mission
    from taichi_sim.config.io import find_config

    task = read_tasks().get(args.what)
    source = find_config(args.what) if task is None else task.source
    config = load_scenario(source, args.overrides)
    shared.start(args)
    mission = make_mission(mission_class(config, source).one_each(config, 1), 1, seed=0, source=source)
    teams = task.teams if task is not None else config.trained or tuple(mission.teams)
    found = {team: interface_of(mission.teams[team]) for team in teams}
    if args.json:
        print(json.dumps(found, indent=2))
    else:
        print("\n\n".join(told(team, interface) for team, interface in found.items()))
