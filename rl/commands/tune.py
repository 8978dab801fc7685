"""Tune a team's classical controller by a search over training worlds; print its numbers or write them to the scenario.

The numbers are those of [TEAM.control] in a scenario; the controllers in rl/guidance/controllers explain them.
"""

import argparse
import sys

from rl.commands import shared
from taichi_sim.options import output, positive_int, refuse_unwritable, seed


def parser() -> argparse.ArgumentParser:
    """The arguments."""
    p = argparse.ArgumentParser(description=__doc__)
    p.add_argument("config", metavar="SCENARIO", help="a file, or the name of a shipped scenario")
    p.add_argument("--team", required=True, help="team whose controller is tuned")
    p.add_argument("--only", default="", metavar="NAME,...", help="numbers to search for (default: all)")
    p.add_argument("--rounds", type=positive_int, default=12, help="rounds of the search (default: 12)")
    p.add_argument("--candidates", type=positive_int, default=12, help="candidates in each round (default: 12)")
    p.add_argument("--episodes", type=positive_int, default=128, help="episodes of each candidate (default: 128)")
    p.add_argument("--seed", type=seed, default=0, help="seed of worlds, episodes and candidates (default: 0)")
    written = p.add_mutually_exclusive_group()
    written.add_argument("--write", action="store_true", help="write the numbers into the scenario's file")
    written.add_argument("--out", type=output, metavar="FILE", help="a new file: the scenario, overridden and tuned")
    shared.add_common(p)
    return p


def main(argv: list[str] | None = None) -> None:
    """Run the command."""
    args = parser().parse_args(argv)
    import tomli_w

    from rl.evaluation.episodes import mission_class
    from rl.missions import load_scenario
    from rl.runs.tune import summary, tune, write_numbers, write_scenario
    from taichi_sim.config import ConfigError
    from taichi_sim.config.io import find_config

    source = find_config(args.config)
    config = load_scenario(source, args.overrides)
    if args.team not in config.teams:
        raise ConfigError(f"--team {args.team}: there is no such team; allowed are {', '.join(config.teams)}")
    if args.write:
        refuse_unwritable(source)
    shared.tell_replaced(config, args.overrides)
    shared.start(args)
    tuned = tune(
        config,
        args.team,
        source=source,
        names=tuple(name for name in args.only.split(",") if name),
        rounds=args.rounds,
        candidates=args.candidates,
        episodes=args.episodes,
        seed=args.seed,
        show_progress=not args.quiet,
    )
    print(summary(tuned, mission_class(config, source).Judge.line), file=sys.stderr)
    print(f"[{args.team}.control]\n{tomli_w.dumps(tuned.numbers)}", end="")
    if args.write:
        runs = f"{args.rounds} rounds of {args.candidates} x {args.episodes} episodes, seed {args.seed}"
        write_numbers(source, args.team, tuned.numbers, f"found by taichi-sim tune: {runs}")
    if args.out:
        write_scenario(args.out, config, source, args.team, tuned.numbers)
