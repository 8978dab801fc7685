"""Measure speed on this machine: agent steps per second without and with policies and learning, the parts of one
step, each vehicle model alone, and peers that are installed.

    python tools/benchmark.py [--json FILE] [--threads N] [--seconds S] [--quick]
    python tools/benchmark.py --against CHECKOUT [--only GROUP ...] [--json FILE] [--seconds S] [--repetitions N]

An agent step is one vehicle's decision. The real-time factor is the simulated time of all environments over wall
time. Figures are medians over repetitions that are interleaved after warm-up; in brackets the slowest and the
fastest repetition over the median (tools/benchmarking/timing.py).

--against measures another checkout of this project (from ff093b3 on) and this one in alternation, case by case, and
gives the medians of the ratios.
"""

import argparse
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

if __package__ in (None, ""):  # run as a script: the packages are beside this file's folder
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from rl.commands import shared
from rl.missions import load_scenario
from rl.missions.formation.config import FormationScenario
from rl.runs import folder as run_folder
from taichi_sim.options import output, positive_float, positive_int
from tools.benchmarking.against import GROUPS, compare
from tools.benchmarking.against import table as ratios_table
from tools.benchmarking.learning import train
from tools.benchmarking.mission import (
    environment_cases,
    first_stage,
    learning_cases,
    measure_parts,
    measure_pictures,
    rates,
    scenario_cases,
)
from tools.benchmarking.peers import measure_peers
from tools.benchmarking.physics import physics_cases
from tools.benchmarking.timing import measure

ROOT = Path(__file__).resolve().parents[1]
QUICK = ("track.worlds=4", "sea.realisations=4", "stages.usv.num_envs=8", "stages.usv.steps_per_iteration=8")
SIZES, QUICK_SIZES = (1, 64, 1024, 4096, 16384), (1, 16)
LEARNING_SIZES = (1024, 2048)  # environments, besides the configured number
LEARNING_ITERATIONS = 20  # iterations whose parts are timed
SCENARIO_SIZE = 512
PARTS_SIZE, QUICK_PARTS_SIZE = 4096, 16
REPETITIONS, QUICK_REPETITIONS = 9, 2
AGAINST_SIZES = (1, 512, 4096)  # environments


def parser() -> argparse.ArgumentParser:
    """The arguments."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--json", type=output, metavar="FILE", help="also write the figures to FILE")
    p.add_argument("--threads", type=positive_int, default=0, help="CPU threads (default: all cores)")
    p.add_argument("--seconds", type=positive_float, default=None, help="length of one repetition, s (default: 0.5)")
    p.add_argument(
        "--quick",
        action="store_true",
        help="tiny cases without the high-fidelity scenarios, to see that it runs; figures mean nothing",
    )
    p.add_argument("--quiet", action="store_true", help="no progress bars")
    p.add_argument("--against", type=Path, metavar="CHECKOUT",
                   help="measure another checkout in alternation, and print ratios")  # fmt: skip
    p.add_argument("--peers", action="store_true", help="compare with the simulators that are installed, alone")
    p.add_argument("--only", nargs="+", choices=GROUPS, default=GROUPS, help="groups to compare (default: all)")
    p.add_argument("--repetitions", type=positive_int, default=REPETITIONS,
                   help="repetitions of --against (default: %(default)s)")  # fmt: skip
    p.set_defaults(arch="cpu")
    return p


def benchmark(config: FormationScenario, *, quick: bool, seconds: float, show_progress: bool) -> dict[str, Any]:
    """All figures, as --json writes them."""
    repetitions = QUICK_REPETITIONS if quick else REPETITIONS
    stage = first_stage(config)
    learning_sizes = (stage.num_envs,) if quick else tuple(sorted({stage.num_envs, *LEARNING_SIZES}))
    parts_size = QUICK_PARTS_SIZE if quick else PARTS_SIZE
    with tempfile.TemporaryDirectory() as folder:
        mission = environment_cases(config, QUICK_SIZES if quick else SIZES)
        mission += learning_cases(config, learning_sizes, Path(folder))
        models = physics_cases(config, parts_size, quick)
        scenarios = [] if quick else scenario_cases(SCENARIO_SIZE)  # their kernels take minutes to compile
        cases = mission + scenarios + [case for case, _ in models]
        measure(cases, seconds=seconds, repetitions=repetitions, show_progress=show_progress)
    learning = train(config, learning_sizes[0], 2 if quick else LEARNING_ITERATIONS)
    parts = measure_parts(config, parts_size, seconds=seconds, repetitions=repetitions, show_progress=show_progress)
    return {
        **{group: rates(mission, group, config) for group in ("environment", "inference", "learning")},
        "scenarios": [{"scenario": case.label, "agent_steps_per_s": case.rate} for case in scenarios],
        "physics": [described | {"vehicle_substeps_per_s": case.rate} for case, described in models],
        "parts": parts,
        "learning_parts": {"num_envs": learning_sizes[0], "seconds": learning["seconds"]} | learning["parts"],
        "picture_ms": measure_pictures(seconds=seconds, repetitions=repetitions),
        "peers": measure_peers(seconds=seconds, show_progress=show_progress),
        "machine": describe_machine(),
        "method": {
            "scenario": config.name,
            "repetitions": repetitions,
            "seconds_per_repetition": seconds,
            "parts_num_envs": parts_size,
            "spread": {f"{case.group} {case.label}": case.spread for case in cases},
        },
    }


def describe_machine() -> dict[str, Any]:
    """CPU, cores, threads used, Python and packages."""
    from taichi_sim.kernels import runtime

    described = run_folder.describe_machine()
    return {
        "cpu": cpu_model(),
        "cores": os.cpu_count(),
        "threads": runtime.current().threads,
        "load_average": os.getloadavg()[0],
        "python": described["python"],
        "packages": described["packages"],
        "git_commit": described["git_commit"],
    }


def cpu_model() -> str:
    """The processor's name."""
    import platform

    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.is_file() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def table(result: dict[str, Any]) -> str:
    """The figures as a readable table."""
    machine, spread = result["machine"], result["method"]["spread"]
    lines = [f"{machine['cpu']}, {machine['cores']} cores, {machine['threads']} threads, "
             f"load {machine['load_average']:.1f}, Python {machine['python']}"]  # fmt: skip

    def brackets(key: str) -> str:
        slow, fast = spread[key]
        return f"[{slow:.2f} .. {fast:.2f}]"

    lines += ["", f"{'':12}{'environments':>14}{'agent steps/s':>16}{'real-time factor':>18}   slowest .. fastest"]
    for group in ("environment", "inference", "learning"):
        lines += [
            f"{group:12}{row['num_envs']:14,}{row['agent_steps_per_s']:16,.0f}{row['real_time_factor']:18,.0f}   "
            + brackets(f"{group} {row['num_envs']}")
            for row in result[group]
        ]
    lines += ["", f"{'scenario':28}{'agent steps/s':>28}"]
    lines += [
        f"{row['scenario']:28}{row['agent_steps_per_s']:28,.0f}   " + brackets(f"scenarios {row['scenario']}")
        for row in result["scenarios"]
    ]
    lines += ["", f"{'vehicle alone':28}{'panels':>8}{'components':>12}{'vehicle substeps/s':>20}"]
    for row in result["physics"]:
        key = f"physics {row['vehicle']}, {row['components']} components"
        lines.append(
            f"{row['vehicle']:28}{row['panels'] or '-':>8}{row['components']:12}"
            f"{row['vehicle_substeps_per_s']:20,.0f}   {brackets(key)}"
        )
    whole = sum(result["parts"].values())
    lines += ["", f"one step of {result['method']['parts_num_envs']:,} environments, all teams: {whole:.3f} ms"]
    ordered = sorted(result["parts"].items(), key=lambda item: -item[1])
    lines += [f"  {part:20}{ms:10.3f} ms{100 * ms / whole:7.1f} %" for part, ms in ordered]
    taken = dict(result["learning_parts"])
    size, seconds = taken.pop("num_envs"), taken.pop("seconds")
    lines += ["", f"one iteration of learning, {size:,} environments, one process: {1000 * seconds:.1f} ms"]
    lines += [f"  {part:20}{1000 * s:10.3f} ms{100 * s / seconds:7.1f} %" for part, s in taken.items()]
    lines += ["", *(f"a picture of {name}, 640x480: {ms:.1f} ms" for name, ms in result["picture_ms"].items())]
    return "\n".join([*lines, "", *peer_lines(result["peers"])])


def peer_lines(records: list[dict[str, Any]]) -> list[str]:
    """The comparison with peers as readable lines."""
    if not records:
        return ["peers: none installed"]
    return ["peers and ours, each at the step at which its motion errs by 1 % (nan: at none tried), one core"] + [
        f"  {p['name'] + ' ' + p['version']:44}{p['step_s']:8.4f} s{p['steps_per_s']:14,.0f} steps/s"
        f"{p['vehicle_seconds_per_s']:12,.0f} vehicle-seconds/s"
        for p in records
    ]


def main(argv: list[str] | None = None) -> None:
    """Run the command."""
    args = parser().parse_args(argv)
    seconds = args.seconds or (0.02 if args.quick else 0.5)
    if args.against:
        result: Any = against(args, seconds)
    else:
        result = alone(args, seconds)
    if args.json:
        run_folder.write_json(args.json, result)


def against(args: argparse.Namespace, seconds: float) -> list[dict[str, Any]]:
    """Compare with another checkout and print the ratios."""
    script = args.against / "tools" / "benchmark.py"
    if not script.is_file():
        raise FileNotFoundError(f"{script}: no such file; --against takes a checkout of this project")
    rows = compare(
        args.against,
        ROOT,
        groups=args.only,
        sizes=QUICK_SIZES if args.quick else AGAINST_SIZES,
        seconds=seconds,
        repetitions=QUICK_REPETITIONS if args.quick else args.repetitions,
    )
    print(ratios_table(rows))
    return rows


def alone(args: argparse.Namespace, seconds: float) -> dict[str, Any]:
    """Measure this checkout and print the figures."""
    config = load_scenario("paper", QUICK if args.quick else ())
    shared.start(args)
    if args.peers:
        records = measure_peers(seconds=seconds, show_progress=not args.quiet)
        print("\n".join(peer_lines(records)))
        return {"peers": records}
    result = benchmark(config, quick=args.quick, seconds=seconds, show_progress=not args.quiet)
    print(table(result))
    return result


if __name__ == "__main__":
    sys.exit(shared.run(main))
