"""Ship trained policies: configs/policies/NAME holds an ONNX file for each team, and policies.json, which says how they
were trained, what they observe, their sums, and their figures on the scenario's held-out episodes.

python tools/ship_policies.py RUN                ships the policies of a run; RUN RUN: of each, a later one counts
python tools/ship_policies.py --remake           trains all shipped policies anew, by their own commands, and ships them
python tools/ship_policies.py --figures          judges what is shipped anew, after a change of episodes
"""

import argparse
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

MADE = ("git_commit", "seed", "scenario_digest")  # of a run's meta.json


def parser() -> argparse.ArgumentParser:
    """The arguments."""
    from rl.commands import shared

    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("runs", nargs="*", type=Path, metavar="RUN", help="finished run folders of rl/train.py")
    p.add_argument("--name", default=None, help="scenario whose policies they become (default: that of the first run)")
    p.add_argument("--remake", action="store_true", help="train anew what is shipped (with --name: of that scenario)")
    p.add_argument("--figures", action="store_true", help="judge anew what is shipped (with --name: of that scenario)")
    p.add_argument("--into", type=Path, default=None, metavar="FOLDER", help="default: configs/policies")
    shared.add_common(p)
    return p


def main(argv: list[str] | None = None) -> None:
    """Run the command."""
    args = parser().parse_intermixed_args(argv)
    from rl.commands import shared
    from rl.learn.policy_sources import ABOUT, shipped_folder
    from rl.runs.folder import RunError, load_config, read_json
    from taichi_sim.errors import refuse

    place = args.into or shipped_folder()
    shipped = sorted(place.glob(f"{args.name or '*'}/{ABOUT}"))
    refuse(
        RunError,
        (bool(args.runs) + args.remake + args.figures != 1, "give run folders, --remake or --figures, one of them"),
        (not args.runs and not shipped, f"{place}: no policies of {args.name or 'any scenario'}"),
        (args.figures and args.overrides, "--figures judges the scenario as it is: leave out --set"),
    )
    shared.start(args)
    if args.runs:
        names = list(dict.fromkeys(load_config(run)[0].name for run in args.runs))
        if len(names) > 1 and args.name is None:
            raise RunError(f"the runs are of {' and '.join(names)}: ship one scenario at a time, or give --name")
        print(ship(args.runs, args.name or names[0], place, args))
        return
    for about in shipped:
        if args.figures:
            print(judge(about.parent.name, place, read_json(about, dict[str, Any])["teams"], args))
            continue
        with tempfile.TemporaryDirectory() as folder:
            print(ship(train(about, Path(folder)), about.parent.name, place, args))


def train(about: Path, folder: Path) -> list[Path]:
    """Train into `folder` by the commands in a policies.json; return the run folders."""
    from rl.runs.folder import read_json

    teams = read_json(about, dict[str, Any])["teams"].values()
    runs = []
    for number, line in enumerate(dict.fromkeys(team["command"] for team in teams)):
        runs.append(folder / str(number))
        command = [sys.executable, "-m", "rl.commands.main", *shlex.split(line)[1:], "--out", str(runs[-1])]
        subprocess.run(command, check=True)
    return runs


def ship(runs: list[Path], name: str, place: Path, args: argparse.Namespace) -> Path:
    """Export the policies of runs into `place`/`name`, judge them there, and write policies.json; return that file."""
    from rl.learn.export import export_onnx
    from rl.learn.policy import load_policy
    from rl.learn.policy_sources import ABOUT, SUFFIX, hashed
    from rl.missions import load_scenario
    from rl.runs.folder import META, load_config, read_json

    config = load_scenario(name, args.overrides)
    teams: dict[str, Any] = {}
    for run in runs:
        own, meta = load_config(run)[0], read_json(run / META, dict[str, Any])
        for team in (team for team in config.trained if (run / team).is_dir()):
            policy, file = load_policy(run, own, team), place / name / f"{team}{SUFFIX}"
            export_onnx(policy.actor, policy.num_observations, file, policy.signature, policy.memory)
            made = {key: meta.get(key) for key in MADE} | {"command": trained_by(meta["command"])}
            teams[team] = made | {"sha256": hashed(file), "bytes": file.stat().st_size} | dict(policy.signature)
        for team in own.given:  # which are of the package already
            teams[team] = read_json(place / name / ABOUT, dict[str, Any])["teams"][team]
    return judge(name, place, teams, args)


def judge(name: str, place: Path, teams: dict[str, Any], args: argparse.Namespace) -> Path:
    """Judge the policies in `place`/`name` on held-out episodes, and write policies.json with `teams`; return it."""
    from rl.evaluation.episodes import judge_episodes
    from rl.learn.policy_sources import ABOUT, SUFFIX, read_onnx
    from rl.missions import load_scenario
    from rl.runs.folder import write_json
    from taichi_sim.config.io import find_config

    config, source = load_scenario(name, args.overrides), find_config(name)
    policies = {team: read_onnx(place / name / f"{team}{SUFFIX}") for team in teams}
    result = judge_episodes(
        config, policies, episodes=config.evaluation.episodes, seed=config.evaluation.seed, source=source,
        show_progress=not args.quiet,
    ).result  # fmt: skip
    about = {"scenario": name, "seed": result["seed"], "episodes": result["episodes"], "figures": result["teams"]}
    write_json(place / name / ABOUT, about | {"teams": teams})
    return place / name / ABOUT


def trained_by(command: list[str]) -> str:
    """The command line of a training, without the place of its run."""
    words = list(command[1:])
    while "--out" in words:
        at = words.index("--out")
        del words[at : at + 2]
    return shlex.join(["taichi-sim", "train", *(word for word in words if not word.startswith("--out="))])


if __name__ == "__main__":
    from rl.commands.shared import run

    sys.exit(run(main))
