"""Measure learning on one process and on several, where its time goes, and predict more processes.

    python tools/scaling.py [--scenario NAME] [--environments N ...] [--repetitions N] [--json FILE]
    python tools/scaling.py --against CHECKOUT     # each set-up beside another checkout at 512 environments

Set-ups are measured in turn, each with its own processes, so that a slow minute of the machine affects all alike.
Figures are medians; ratios are medians of the ratios in one round. The class `Cost` has the model.
"""

import argparse
import json
import math
import os
import statistics
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

if __package__ in (None, ""):  # run as a script: the packages are beside this file's folder
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from rl.commands import shared
from rl.runs import folder as run_folder
from rl.runs import torchrun
from taichi_sim.options import output, positive_int
from tools.benchmarking.against import Worker

WORKER = Path(__file__).with_name("benchmarking") / "learning.py"
ITERATIONS = 8
PREDICTED = (1, 2, 8, 64, 1000)  # cores
MANY = 100_000  # environments


class Link(NamedTuple):
    """Latency and bandwidth between processes."""

    name: str
    latency: float  # latency of a message, s
    bandwidth: float  # bytes/s


LINKS = (  # typical figures; assumed
    Link("memory of one machine", 20e-6, 2e9),
    Link("10 Gbit/s Ethernet", 60e-6, 1.1e9),
    Link("100 Gbit/s, RDMA", 5e-6, 11e9),
)


class Cost(NamedTuple):
    """A model of the time of a learning iteration on P processes; all its numbers are measured.

        T(P) = W(n / P) (1 + s sqrt(2 ln P)) + S (2 log2(P) l + 2 (P - 1) / P b / B)

    W(e) = a + c e      time of a process with e environments on a core of its own, s: a line through measurements;
    s                   spread of that time between iterations over its mean. All wait for the slowest process, which is
                        about sqrt(2 ln P) standard deviations late for P normal draws;
    S, b                number of synchronisations in an iteration, and bytes of each;
    l, B                latency of a message, and bandwidth, between machines: an all-reduce by halving and doubling
                        takes 2 log2(P) messages and moves 2 (P - 1) / P of its bytes (Thakur et al. 2005, section 4.5).
    """

    fixed: float  # a, s
    each: float  # c, s for each environment
    spread: float  # s
    calls: int  # S
    bytes: float  # b, bytes of one synchronisation
    steps: float  # agent-steps of one environment in an iteration

    def work(self, envs: float) -> float:
        """Time W of a process with `envs` environments, s."""
        return self.fixed + self.each * envs

    def seconds(self, envs: int, processes: int, link: Link) -> float:
        """Time T of an iteration, s."""
        late = 1 + self.spread * math.sqrt(2 * math.log(processes)) if processes > 1 else 1.0
        talk = 2 * math.log2(processes) * link.latency
        talk += 2 * (processes - 1) / processes * self.bytes / link.bandwidth
        return self.work(envs / processes) * late + self.calls * talk

    def rate(self, envs: int, processes: int, link: Link) -> float:
        """Learning speed, agent-steps/s."""
        return envs * self.steps / self.seconds(envs, processes, link)

    def worth(self, envs: int, link: Link, least: float = 0.5) -> int:
        """The largest power of two of processes whose efficiency, compared with one process, is at least `least`."""
        one, count = self.rate(envs, 1, link), 1
        while count < envs and self.rate(envs, 2 * count, link) >= least * 2 * count * one:
            count *= 2
        return count


def fitted(seconds: Mapping[int, float], spread: float, calls: int, of_each: float, steps: float) -> Cost:
    """Fit the model to one process on one core (environments -> seconds) by least squares of relative errors."""
    envs, taken = np.array(list(seconds)), np.array(list(seconds.values()))
    matrix = np.stack([np.ones_like(taken), envs], axis=1) / taken[:, None]
    fixed, each = np.linalg.lstsq(matrix, np.ones_like(taken), rcond=None)[0]
    return Cost(max(float(fixed), 0.0), float(each), spread, calls, of_each, steps)


class StageSetup(NamedTuple):
    """Processes, threads and environments of a stage."""

    processes: int
    threads: int  # threads of each process
    envs: int  # environments of all processes together

    def __str__(self) -> str:
        """Name of the set-up in tables."""
        return f"{self.processes} x {self.threads}, {self.envs} environments"


def parser() -> argparse.ArgumentParser:
    """The arguments."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--scenario", default="paper", help="its first stage is trained (default: paper)")
    p.add_argument("--environments", type=positive_int, nargs="+", default=[512, 2048], metavar="N")
    p.add_argument("--repetitions", type=positive_int, default=5, metavar="N", help="rounds (default: 5)")
    p.add_argument("--against", type=Path, metavar="CHECKOUT", help="another checkout of this project, from ff093b3 on")
    p.add_argument("--json", type=output, metavar="FILE", help="also write the figures to FILE")
    p.add_argument("--quiet", action="store_true", help="no progress bar")
    return p


def measure(scenario: str, setting: StageSetup) -> dict[str, Any]:
    """Time an iteration (benchmarking/learning.py) in new processes."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "times.json"
        words = [scenario, str(setting.envs), str(ITERATIONS), str(setting.threads), str(file)]
        torchrun.run(WORKER, words, setting.processes)
        return json.loads(file.read_text(encoding="utf-8"))


def settings(envs: list[int]) -> list[StageSetup]:
    """The set-ups to measure.

    For each number of environments: one process with all cores, one with a single core, and one process for each core.
    The model also needs one process with a single core at other numbers.
    """
    cores = len(os.sched_getaffinity(0))
    found = [StageSetup(p, t, n) for n in envs for p, t in ((1, cores), (1, 1), (cores, 1))]
    share = {max(1, n // cores) for n in envs} | {64, 2 * max(envs)}
    return list(dict.fromkeys(found + [StageSetup(1, 1, n) for n in sorted(share)]))


def main(argv: list[str] | None = None) -> None:
    """Run the command."""
    args = parser().parse_args(argv)
    tried = settings(args.environments)
    other = Worker(args.against, ("learning",), (1,)) if args.against else None
    timed: dict[StageSetup, list[dict[str, Any]]] = {setting: [] for setting in tried}
    before: list[float] = []
    if other:
        other.ask("run 0 2")
    for _ in tqdm(range(args.repetitions), desc="measure", unit="round", disable=args.quiet):
        for setting in tried:
            timed[setting].append(measure(args.scenario, setting))
            if other:
                before.append(other.ask(f"run 0 {ITERATIONS}"))
    result = summary(tried, timed, before)
    print(table(result))
    if args.json:
        run_folder.write_json(args.json, result)


def summary(
    tried: list[StageSetup], timed: dict[StageSetup, list[dict[str, Any]]], before: list[float]
) -> dict[str, Any]:
    """All figures, as --json writes them."""
    rates = {setting: [of["agent_steps"] / of["seconds"] for of in found] for setting, found in timed.items()}
    rows = []
    for number, (setting, found) in enumerate(timed.items()):
        base = next(s for s in tried if s.envs == setting.envs and s.processes == 1)
        row = setting._asdict() | {
            "agent_steps_per_s": statistics.median(rates[setting]),
            "over_one_process": statistics.median(a / b for a, b in zip(rates[setting], rates[base], strict=True)),
            "seconds": statistics.median(of["seconds"] for of in found),
            "parts": {part: statistics.median(of["parts"][part] for of in found) for part in found[0]["parts"]},
            "calls": found[0]["calls"],
            "bytes": found[0]["bytes"],
        }
        if before:
            near = before[number :: len(tried)]
            steps = 512 * found[0]["agent_steps"] / setting.envs
            row["over_other"] = statistics.median(r * t / steps for r, t in zip(rates[setting], near, strict=True))
        rows.append(row)
    return {"settings": rows, "model": model(tried, timed)}


def model(tried: list[StageSetup], timed: dict[StageSetup, list[dict[str, Any]]]) -> dict[str, Any]:
    """Fit the cost model to single processes with one thread; predict the measured set-ups and more."""
    alone = {
        s.envs: statistics.median(of["seconds"] for of in timed[s]) for s in tried if s.processes == s.threads == 1
    }
    several = [s for s in tried if s.processes > 1]
    first = timed[several[0]][0] if several else {"calls": 0, "bytes": 0}
    spread = statistics.median(of["spread"] for s in tried for of in timed[s])
    some = timed[tried[0]][0]
    each = first["bytes"] / max(first["calls"], 1)
    cost = fitted(alone, spread, first["calls"], each, some["agent_steps"] / tried[0].envs)
    checked = [
        {
            "processes": s.processes,
            "envs": s.envs,
            "predicted_s": cost.seconds(s.envs, s.processes, LINKS[0]),
            "measured_s": statistics.median(of["seconds"] for of in timed[s]),
        }
        for s in several
    ]
    return cost._asdict() | {
        "fitted_to": alone,
        "checked": checked,
        "predicted": [
            {"processes": p, "envs": n, "link": link.name, "agent_steps_per_s": cost.rate(n, p, link)}
            for n in (4096, MANY)
            for link in LINKS
            for p in PREDICTED
        ],
        "worth": [
            {"envs": n, "link": link.name, "processes": cost.worth(n, link)} for n in (4096, MANY) for link in LINKS
        ],
    }


def table(result: dict[str, Any]) -> str:
    """Markdown, as in docs/scaling.md."""
    rows = result["settings"]
    parts = list(rows[0]["parts"])
    against = any("over_other" in row for row in rows)
    head = ["processes x threads", "environments", "agent-steps/s", "over one process", "s an iteration", *parts]
    head += ["over the other checkout at 512"] if against else []
    lines = ["| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    for row in rows:
        rate = row["agent_steps_per_s"]
        cells = [f"{row['processes']} x {row['threads']}", f"{row['envs']:,}", f"{rate / 1000:.0f} thousand"]
        cells += [f"{row['over_one_process']:.2f}", f"{row['seconds']:.3f}"]
        cells += [f"{row['parts'][part]:.3f}" for part in parts]
        cells += [f"{row['over_other']:.2f}"] if against else []
        lines.append("| " + " | ".join(cells) + " |")
    found = result["model"]
    fixed, each, spread = found["fixed"], 1000 * found["each"], 100 * found["spread"]
    lines += [
        "",
        f"An iteration of one process on a core: {fixed:.3f} s and {each:.3f} ms an environment; spread "
        f"{spread:.1f} %; {found['calls']} synchronisations of {found['bytes']:.0f} bytes in mean.",
        "",
        "| processes | environments | predicted, s | measured, s |",
        "|---|---|---|---|",
        *(
            f"| {row['processes']} | {row['envs']:,} | {row['predicted_s']:.3f} | {row['measured_s']:.3f} |"
            for row in found["checked"]
        ),
        "",
        "| environments | link | " + " | ".join(f"{p:,} cores" for p in PREDICTED) + " | half as efficient at |",
        "|---" * (3 + len(PREDICTED)) + "|",
    ]
    for envs in dict.fromkeys(row["envs"] for row in found["predicted"]):
        for link in LINKS:
            rates = [
                row["agent_steps_per_s"]
                for row in found["predicted"]
                if row["envs"] == envs and row["link"] == link.name
            ]
            worth = next(w["processes"] for w in found["worth"] if w["envs"] == envs and w["link"] == link.name)
            shown = " | ".join(f"{rate / 1e6:.2f}M" for rate in rates)
            lines.append(f"| {envs:,} | {link.name} | {shown} | {worth:,} |")
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(shared.run(main))
