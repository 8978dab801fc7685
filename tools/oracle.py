"""Find the best possible result in a scenario: episodes of an oracle and of the classical controller, stored for
tables and for the benchmark (docs/benchmark.md).

The oracle plans in forks of the true simulation, including its future (rl/planning). Its episodes are written to
configs/oracle/NAME.json, which tools/compare.py and reports read.
"""

import argparse
import sys

from taichi_sim.options import output, positive_int, refuse_unwritable, seed


def parser() -> argparse.ArgumentParser:
    """The arguments."""
    from rl.commands import shared
    from rl.evaluation.headroom import EPISODES, SEED

    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("scenario", help="name or file")
    p.add_argument("--team", action="append", help="only this team (may be given again); default: all that are trained")
    p.add_argument("--episodes", type=positive_int, default=EPISODES, help=f"default: {EPISODES}")
    p.add_argument("--seed", type=seed, default=SEED, help=f"seed of the held-out episodes (default: {SEED})")
    p.add_argument("--classical", action="store_true", help="the classical controller alone: seconds, not hours")
    p.add_argument("--out", type=output, default=None, help="default: configs/oracle/NAME.json")
    shared.add_common(p)
    return p


def main(argv: list[str] | None = None) -> None:
    """Run the command."""
    args = parser().parse_args(argv)
    from rl.commands import shared
    from rl.evaluation.benchmark import frozen, read_tasks
    from rl.evaluation.episodes import mission_class
    from rl.evaluation.headroom import bound_file, headroom_line, read_levels, run_bound, write_bounds
    from rl.missions import load_scenario
    from taichi_sim.config import ConfigError
    from taichi_sim.config.io import find_config

    source = find_config(args.scenario)
    config = load_scenario(args.scenario, args.overrides)
    teams = args.team or list(config.trained)
    if wrong := [team for team in teams if team not in config.trained]:
        raise ConfigError(f"--team {wrong[0]}: allowed are {', '.join(config.trained)}")
    shared.start(args)
    file = args.out or bound_file(config)
    refuse_unwritable(file)
    bounds = read_levels(config, file)
    judge = mission_class(config, source).Judge
    for team in teams:
        bounds[team] = bound = run_bound(
            config, team, episodes=args.episodes, seed=args.seed, source=source, show_progress=not args.quiet,
            plan=not args.classical,
        )  # fmt: skip
        print(headroom_line(judge, team, bound))
        write_bounds(file, config, bounds)
    print(file)
    for name, task in read_tasks().items():
        if task.scenario == config.name and set(task.teams) & set(teams) and args.out is None:
            print(f"{name}: digest = {frozen(task)!r} (configs/benchmark/v1.toml)")


if __name__ == "__main__":
    from rl.commands.shared import run

    sys.exit(run(main))
