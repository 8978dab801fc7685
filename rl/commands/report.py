"""Write a run, or two runs side by side, as one HTML page."""

import argparse
from pathlib import Path

from taichi_sim.options import output


def parser() -> argparse.ArgumentParser:
    """The arguments."""

    p = argparse.ArgumentParser(description=__doc__)
    p.add_argument("run", type=Path, metavar="RUN", help="run folder of rl/train.py")
    p.add_argument("other", type=Path, metavar="OTHER", nargs="?", help="another run for a second column")
    p.add_argument("--out", type=output, default=None, metavar="FILE.html", help="the page (default: RUN/report.html)")
    return p


def main(argv: list[str] | None = None) -> None:
    """Run the command."""
    args = parser().parse_args(argv)
    from rl.evaluation.report import write_report

    print(write_report([args.run, args.other] if args.other else [args.run], args.out))
