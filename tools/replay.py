"""Repeat the last step of an environment whose state stopped being finite, from its dump, and print it.

    python tools/replay.py runs/NAME/dumps/000.dump

Training writes such a dump (taichi_sim/state/divergence_dump.py). Exit status: 0 the step was repeated, 2 the file is
not a dump.
"""

import argparse
import sys
from pathlib import Path

import torch

from taichi_sim.errors import command
from taichi_sim.kernels import runtime
from taichi_sim.state.divergence_dump import load_dump
from taichi_sim.world import replay


@command("replay")
def main(argv: list[str] | None = None) -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description="Repeat the last step of a diverged environment from its dump.")
    parser.add_argument("dump", type=Path, help="a file of runs/NAME/dumps")
    parser.add_argument("--precision", choices=("f32", "f64"), default="f32",
                        help="f64 shows whether rounding was the cause")  # fmt: skip
    arguments = parser.parse_args(argv)
    dump = load_dump(arguments.dump)
    runtime.init(precision=arguments.precision)
    world = replay(dump, arguments.dump.resolve().parents[1] / "config.toml")
    print(f"{dump.fault}; scenario {dump.config.name}, sea {dump.sea}, t = {dump.time:.2f} s")
    for name, team in world.teams.items():
        for vehicle in range(team.count):
            before, after = dump.states[name][vehicle], team.state[0, vehicle]
            print(f"{name} {vehicle}: action {_row(dump.actions[name][vehicle])}")
            print(f"  before {_row(before)}")
            print(f"  after  {_row(after)}{'' if torch.isfinite(after).all() else '   <- not finite'}")


def _row(values: torch.Tensor) -> str:
    return " ".join(f"{value:.4g}" for value in values.tolist())


if __name__ == "__main__":
    sys.exit(main())
