"""How likely a rare failure is: multilevel splitting on kept states, with a 95 % interval."""

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rl.evaluation.odds.estimate import Question
    from rl.evaluation.odds.film import Line

if __package__ in (None, ""):  # run as a script: the packages are beside this file's folder
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

CONTROLLERS = ("policy", "untrained", "classical")  # planners have a memory of their own


def parser() -> argparse.ArgumentParser:
    """The arguments."""
    from rl.commands import shared
    from taichi_sim.options import output, positive_float, positive_int

    p = argparse.ArgumentParser(description=__doc__, epilog="docs/odds.md explains what is printed.")
    shared.add_run(p, CONTROLLERS)
    p.add_argument("--of", default="collided", metavar="ENDING", help="ending of a vehicle (default: %(default)s)")
    p.add_argument("--team", default=None, metavar="TEAM", help="team whose ending it is (default: each in turn)")
    p.add_argument("--relative", type=positive_float, default=0.2, metavar="X",
                   help="standard error that is wanted, over the probability (default: %(default)s)")  # fmt: skip
    p.add_argument("--effort", type=positive_int, default=512, metavar="N",
                   help="paths at each level (default: %(default)s)")  # fmt: skip
    p.add_argument("--direct", action="store_true", help="no levels: episodes from beginning to end")
    p.add_argument("--again", type=Path, default=None, metavar="FILE", help="record the failure that --json FILE names")
    p.add_argument("--out", default=None, metavar="FILE.rrd", help="record the likeliest failure for rerun")
    shared.add_film(p)
    p.add_argument("--json", type=output, default=None, metavar="FILE", help="also write all figures to FILE")
    shared.add_processes(p, "repeats")
    return p


def main(argv: list[str] | None = None) -> None:
    """Run the command."""
    args = parser().parse_args(argv)
    from rl.evaluation.odds.estimate import REPEATS
    from rl.runs import ranks, torchrun

    number = torchrun.process_count(args.processes or 1, args.threads, REPEATS, args.arch, enough=1)
    if number > 1:
        torchrun.run(Path(__file__), sys.argv[1:] if argv is None else argv, number)
        return
    with ranks.joined(args.arch):
        odds(args)


def odds(args: argparse.Namespace) -> None:
    """Estimate for one team or each; rank 0 prints and writes."""
    from rl.commands import shared
    from rl.evaluation.episode_recording import output_of
    from rl.evaluation.odds.estimate import Question, find_odds
    from rl.evaluation.odds.film import likeliest, record
    from rl.evaluation.odds.report import as_json, text
    from rl.evaluation.store import save_odds
    from rl.runs import folder as run_folder
    from rl.runs import ranks
    from taichi_sim.visualisation.film.files import check_film, write_film

    output, how = output_of(args.out), shared.film_options(args)
    config, source, policies, seed = shared.open_run(args)
    shared.agree(config, source)
    if args.film:
        check_film(args.film, **how, teams=config.teams)
    if args.relative >= 1.0:
        raise run_folder.RunError(f"--relative {args.relative:g}: must be below 1")
    teams = list(policies) if args.team is None else [args.team]
    if len(teams) > 1 and (args.film or args.out or args.again):
        raise run_folder.RunError(f"--film, --out, --again: name one --team of {', '.join(teams)}")
    answers, stored = {}, shared.stores(args)
    for team in teams:
        asked = Question(config, policies, team, args.of, seed, source, args.controller).among_its_teams()
        line = again(args.again, asked)
        if line is None:
            answer = find_odds(asked, args.effort, args.relative, direct=args.direct, show_progress=not args.quiet)
            if answer is None:  # another rank tells
                continue
            answers[team], line = as_json(answer), likeliest(answer)
            print(text(answer))
            if stored:
                save_odds(args.run, answers[team], args.config, args.overrides)
            if args.json:
                run_folder.write_json(args.json, answers)
            if answer.interrupted is not None:
                raise answer.interrupted
        if not (args.film or args.out) or not ranks.here().first:
            continue
        if line is None:
            print("no failure to record", file=sys.stderr)
            continue
        episode = record(asked, line)
        if args.film:
            print(f"film: {write_film(episode, args.film, **how, show_progress=not args.quiet)}")
        if output.place:
            print(f"recording: {output.reader} {output.write(episode, output.place)}")


def again(file: Path | None, asked: "Question") -> "Line | None":
    """The failure that --again names; None without it."""
    from rl.evaluation.odds.film import Line
    from rl.runs.folder import RunError

    if file is None:
        return None
    try:
        told = json.loads(file.read_text())[asked.team]
        same = (told["scenario"], told["ending"], told["seed"]) == (asked.config.name, asked.ending, asked.seed)
        if same and told["likeliest"] is not None:
            return Line.of_json(told["likeliest"])
    except (ValueError, KeyError, TypeError) as error:
        raise RunError(f"--again {file}: not written by --json for {asked.team}: {error!r}") from None
    raise RunError(
        f"--again {file}: holds no failure of {asked.team} {asked.ending} in {asked.config.name!r}, seed {asked.seed}"
    )


if __name__ == "__main__":
    from rl.commands.shared import script

    script(main)
