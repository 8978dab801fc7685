"""Score a policy in a task of the benchmark: 0 is the classical controller, 100 the oracle (docs/benchmark.md)."""

import argparse
from pathlib import Path
from typing import Any

from rl.commands import shared
from taichi_sim.options import output, positive_int


def parser() -> argparse.ArgumentParser:
    """The arguments; a task's episodes, seed and scenario are frozen, so none of them is one."""
    from rl.evaluation.benchmark import read_tasks

    tasks = "\n".join(f"  {name}: {', '.join(task.teams)}, {task.figure}" for name, task in read_tasks().items())
    p = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog=f"tasks, their teams, and what is judged:\n{tasks}",
    )  # fmt: skip
    p.add_argument("task", metavar="TASK")
    p.add_argument(
        "--policy",
        action="append",
        default=[],
        metavar="[TEAM=]POLICY",
        help="a run's folder, pretrained, FILE.onnx or module:function; repeatable (default: pretrained)",
    )
    p.add_argument(
        "--controller", choices=("policy", "honest"), default="policy",
        help="honest: a planner that knows what the vehicles know, in place of policies; minutes (docs/planning.md)",
    )  # fmt: skip
    p.add_argument("--json", type=output, default=None, metavar="FILE", help="write all that a check needs to FILE")
    p.add_argument("--threads", type=positive_int, default=0, help="CPU threads (default: all cores)")
    p.add_argument("--quiet", action="store_true", help="print the scores alone")
    p.set_defaults(arch="cpu")
    return p


def main(argv: list[str] | None = None) -> None:
    """Run the command."""
    args = parser().parse_args(argv)
    from rl.evaluation import benchmark
    from rl.learn.policy_sources import policies_from
    from rl.planning.planner import HonestPlanner
    from rl.runs.folder import RunError, describe_machine, write_json
    from rl.scenario import PRETRAINED

    task, config, levels = benchmark.open_task(args.task)
    if args.controller == "honest":
        if args.policy:
            raise RunError(f"--policy {args.policy[0]}: --controller honest controls: leave one of them out")
        sources, policies = ["honest"], {team: HonestPlanner() for team in task.teams}
    else:
        sources = args.policy or [PRETRAINED]
        policies = policies_from(sources, config, task.teams)
    shared.tell_unnamed(policies)
    shared.start(args)
    found = benchmark.score(task, config, levels, policies, show_progress=not args.quiet)
    for team, scored in found.items():
        text = benchmark.told(args.task, task, team, scored, levels[team].episodes)
        print(text.splitlines()[0] if args.quiet else text)
    if args.json:
        frozen: dict[str, Any] = {"task": args.task, "digest": task.digest, "figure": task.figure, "safe": task.safe}
        made = {"policies": sources, "sha256": hashes(policies), "software": describe_machine()}
        episodes = {t: {"seed": levels[t].seed, "episodes": levels[t].episodes} for t in found}
        of_teams = {team: {**episodes[team], **scored} for team, scored in found.items()}
        write_json(args.json, frozen | {"teams": of_teams} | made)


def hashes(policies: dict[str, Any]) -> dict[str, str]:
    """SHA-256 of the files of policies that are one."""
    from rl.learn.policy_sources import hashed

    files = {team: Path(getattr(policy, "source", "")) for team, policy in policies.items()}
    return {team: hashed(file) for team, file in files.items() if file.is_file()}
