"""Measure whether two teams need each other: an escort's runs with parts taken away, on the same episodes.

Each run's policies are judged together under several conditions: without messages, with those of another environment,
with many lost or late messages; beside a classical partner or one of another training seed; in teams of other sizes.
The classical controllers of both teams are judged with and without messages.

The result is a Markdown table with 95 % intervals: shares, errors, and the mean time of arrival divided by that of
classical controllers without and with messages. Several runs are judged together: intervals draw episodes, each with
the results of all runs. Results are stored in RUN/cooperation, so that an interrupted command continues.
"""

import argparse
import hashlib
import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

if __package__ in (None, ""):  # run as a script: the packages are beside this file's folder
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from taichi_sim.options import positive_int, seed
from tools.compare import joined

POLICY, CLASSICAL, NEXT, ALONE = "policy", "classical", "of the next run", "trained alone"
NONE = 'escort.reports="none"'
STEADY = ("course.speed=[1.2,1.2]", "sea.sea_state=3", "air.speed=7.72")  # 15 kt


class Condition(NamedTuple):
    """A condition: overrides of the scenario, and the controllers."""

    name: str
    overrides: tuple[str, ...] = ()
    boats: str = POLICY
    aircraft: str = POLICY


ALONE_BOTH = Condition("classical both, no messages", (NONE,), CLASSICAL, CLASSICAL)
TOGETHER_BOTH = Condition("classical both, cooperating", (), CLASSICAL, CLASSICAL)
CASES = (
    ALONE_BOTH,
    TOGETHER_BOTH,
    Condition("learned, together"),
    Condition("the same, no messages", (NONE,)),
    Condition("the same, messages of another environment", ('escort.reports="others"',)),
    Condition("the same, half of all messages lost", ("radio.loss=0.5",)),
    Condition("the same, 90 % lost", ("radio.loss=0.9",)),
    Condition("the same, 2 s late", ("radio.delay=2.0",)),
    Condition("boats trained without messages, and sailing so", (NONE,), ALONE),
    Condition("boats learned, aircraft classical", (), POLICY, CLASSICAL),
    Condition("boats classical, aircraft learned", (), CLASSICAL, POLICY),
    Condition("partners of another training seed", (), POLICY, NEXT),
    Condition("5 boats, 2 aircraft", ("{boats}.count=5", "{aircraft}.count=2")),
    Condition("8 boats, 8 aircraft", ("{boats}.count=8", "{aircraft}.count=8")),
    Condition("steady: classical both", STEADY, CLASSICAL, CLASSICAL),
    Condition("steady: learned, together", STEADY),
)
FIGURES = (  # part, figure, heading, factor, digits
    ("boats", "mean_time_to_arrive_s", "mean time to arrive, s", 1, 0),
    ("boats", "time_to_arrive_s", "median, s", 1, 0),
    ("boats", "never_arrives", "never, %", 100, 1),
    ("boats", "leader_error_rms_m", "leader, m", 1, 2),
    ("boats", "follower_error_rms_m", "followers, m", 1, 2),
    ("boats", "aware", "aware, %", 100, 1),
    ("aircraft", "in_camera", "in a camera, %", 100, 1),
    ("boats", "collision_free_episodes", "free: boats, %", 100, 1),
    ("aircraft", "collision_free_episodes", "free: aircraft, %", 100, 1),
    ("boats", "success_rate", "success, %", 100, 1),
)


def parser() -> argparse.ArgumentParser:
    """The arguments."""
    from rl.commands import shared

    p = argparse.ArgumentParser(description=__doc__)
    p.add_argument("runs", nargs="+", type=Path, metavar="RUN", help="run folders of rl/train.py --config escort")
    p.add_argument("--alone", nargs="*", type=Path, default=[], metavar="RUN", help="runs trained without messages")
    p.add_argument("--seed", type=seed, default=None, help="seed of the held-out episodes (default: the scenario's)")
    p.add_argument("--episodes", type=positive_int, default=None,
                   help="episodes of each condition (default: the scenario's)")  # fmt: skip
    p.add_argument("--only", default="", metavar="WORDS", help="only conditions whose name contains these words")
    shared.add_common(p)
    return p


def main(argv: list[str] | None = None) -> None:
    """Run the command."""
    args = parser().parse_intermixed_args(argv)
    from rl.commands import shared

    shared.start(args)
    found: dict[Condition, list[Any]] = {}
    judge: Any = None
    for case in CASES:
        if args.only not in case.name or (case.boats == ALONE and not args.alone):
            continue
        runs = args.runs[:1] if CLASSICAL == case.boats == case.aircraft else args.runs
        if case.boats == ALONE:
            runs = args.alone
        for number, run in enumerate(runs):
            if NEXT in (case.boats, case.aircraft) and len(args.runs) < 2:
                continue
            if not args.quiet:
                print(f"{case.name}: {run}", file=sys.stderr)
            judge, episodes = judged(case, run, args.runs[(number + 1) % len(args.runs)], args)
            found.setdefault(case, []).append(episodes)
    print(table(found, judge))


def judged(case: Condition, run: Path, partner: Path, args: argparse.Namespace) -> tuple[Any, dict[str, Any]]:
    """Judge both teams under one condition: the mission's judge, and their episodes (stored ones if they exist)."""
    from rl.evaluation.episodes import judge_episodes, mission_class
    from rl.learn.policy import ClassicalPolicy, checkpoints, load_policy
    from rl.runs.folder import load_config
    from taichi_sim.config.io import toml_text

    plain, _ = load_config(run, args.overrides)
    parts = {"boats": plain.escort.boats, "aircraft": plain.escort.aircraft}
    config, source = load_config(run, [*args.overrides, *(text.format(**parts) for text in case.overrides)])
    seed = config.evaluation.seed if args.seed is None else args.seed
    count = args.episodes or config.evaluation.episodes
    kind = mission_class(config, source).Judge
    acting = (run, partner) if NEXT in (case.boats, case.aircraft) else (run,)
    newest = [checkpoints(folder / name)[-1:] for folder in acting for name in parts.values()]
    key = f"{toml_text(config)}{seed} {count} {case} {newest}"
    kept = run / "cooperation" / f"{hashlib.sha256(key.encode()).hexdigest()[:16]}.npz"
    if kept.is_file():
        with np.load(kept) as file:
            flat = {key: file[key] for key in file.files}
        return kind, {
            part: {key.split("/", 1)[1]: v for key, v in flat.items() if key.split("/", 1)[0] == part} for part in parts
        }
    policies: dict[str, Any] = {}
    for part, who in (("boats", case.boats), ("aircraft", case.aircraft)):
        name = parts[part]
        folder = partner if who == NEXT else run
        if who == CLASSICAL or (case.boats == ALONE and part == "aircraft"):
            policies[name] = ClassicalPolicy()
        else:
            policies[name] = load_policy(folder, config, name)
    outcome = judge_episodes(config, policies, episodes=count, seed=seed, source=source, show_progress=not args.quiet)
    episodes = {part: outcome.episodes[name] for part, name in parts.items()}
    kept.parent.mkdir(exist_ok=True)
    np.savez(kept, **{f"{part}/{key}": value for part, of in episodes.items() for key, value in of.items()})
    return kind, episodes


def table(found: dict[Condition, list[Any]], judge: Any) -> str:
    """Markdown: a row for each condition."""
    head = [heading for _, _, heading, _, _ in FIGURES]
    lines = [
        "| | " + " | ".join(head) + " | time over classical without messages | over classical cooperating |",
        "|---" * (3 + len(head)) + "|",
    ]
    for case, runs in found.items():
        together = {part: joined([run[part] for run in runs]) for part in ("boats", "aircraft")}
        cells = []
        for part, key, _, factor, digits in FIGURES:
            value = float(judge.pooled(together[part])[key])
            cells.append(f"{factor * value:.{digits}f}" if np.isfinite(value) else "-")
        steady = case.name.startswith("steady")
        for other in (ALONE_BOTH, TOGETHER_BOTH):
            same = other in found and not steady and not any("count" in text for text in case.overrides)
            cells.append(ratio(together, found[other], len(runs), judge) if same and other != case else "-")
        lines.append(f"| {case.name} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def ratio(together: dict[str, Any], other: list[Any], times: int, judge: Any) -> str:
    """Ratio of the mean times of arrival with its interval."""
    from rl.evaluation.intervals import ratios

    repeated = joined([other[0]["boats"]] * times)
    middle, low, high = (x or 0.0 for x in ratios(judge, together["boats"], repeated, times)["mean_time_to_arrive_s"])
    return f"{middle:.2f} ({low:.2f} to {high:.2f})"


if __name__ == "__main__":
    from rl.commands.shared import run

    sys.exit(run(main))
