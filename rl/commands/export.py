"""Write the tables of a recording (.rrd): vehicles' motion, actions and errors, and the conditions of its episodes."""

import argparse
from pathlib import Path

from taichi_sim.options import table


def parser() -> argparse.ArgumentParser:
    """The arguments."""
    p = argparse.ArgumentParser(description=__doc__)
    p.add_argument("recording", type=Path, metavar="FILE.rrd", help="a recording of taichi-sim play or train")
    p.add_argument(
        "--out", type=table, required=True, metavar="FILE",
        help="write vehicles' motion to FILE (.parquet or .csv), and conditions of each episode beside it",
    )  # fmt: skip
    return p


def main(argv: list[str] | None = None) -> None:
    """Run the command."""
    args = parser().parse_args(argv)
    from rl.evaluation.export import export_recording

    print(f"export: {args.out}, {export_recording(args.out, args.recording)}")
