"""Find the physics step that a vehicle needs: the error of its motion at steps from 0.01 to 0.1 s.

    taichi-sim step VEHICLE [--out FILE.png]

    taichi-sim step otter
    taichi-sim step aerosonde --seconds 30

VEHICLE is a vehicle file, or the name of a shipped one. Printed are the errors, the step at which the motion errs by
1 %, which is the key `dt` of a vehicle file, and the largest stable step; drawn is error against cost. docs/step.md
defines the error.

Exit status: 0 done, 2 bad input.
"""

import math
import sys
from collections.abc import Sequence
from pathlib import Path

from taichi_sim.applications.trials.step_error import INTERVAL, ONE_PERCENT, StepError, StepSetting, errors, step_for
from taichi_sim.errors import command
from taichi_sim.kernels import runtime
from taichi_sim.models.catalogue import load_vehicle
from taichi_sim.options import parser_of, picture, ranged, refuse_unwritable

STEPS = tuple(INTERVAL / n for n in (20, 10, 8, 5, 4, 3, 2))  # s
FINE = 0.0025  # s, counts as exact
SHORT = 1e-3  # s, a step that every vehicle accepts


def lines(vehicle: str, found: Sequence[StepError], largest: float) -> list[str]:
    """The printed lines."""
    told = [f"{vehicle}: error of the motion, of u v w p q r (%), of the position at the end (m)"]
    for e in found:
        told.append(f"  {e.dt:7.4f} s {100 * e.total:8.3f}  " + "".join(f"{100 * x:8.3f}" for x in e.parts)
                    + f"{e.position:10.4f}")  # fmt: skip
    step = step_for(found)
    told.append("1 % at no step of these" if math.isnan(step) else f"1 % at {step:.3g} s")
    return [*told, f"largest stable step {largest:.3g} s"]


def draw(vehicle: str, found: Sequence[StepError], file: Path) -> None:
    """Draw error against steps a second."""
    from taichi_sim.visualisation.plotting import dress, new_figure

    figure = new_figure(6.0, 4.0, f"Error of {vehicle} against cost")
    axes = figure.subplots()
    axes.loglog([1 / e.dt for e in found], [100 * e.total for e in found], "o-", label="motion")
    axes.axhline(100 * ONE_PERCENT, color="#888888", linewidth=0.8)
    dress(axes, "root mean square of the six velocities", "physics steps per simulated second", "error (%)")
    figure.savefig(file, dpi=120)


@command("step")
def main(argv: list[str] | None = None) -> None:
    """Run the command."""
    p = parser_of(__doc__, "taichi-sim step")
    p.add_argument("vehicle", metavar="VEHICLE", help="vehicle file, or the name of a shipped one")
    p.add_argument("--seconds", type=ranged(float, 1.0, 1000.0), default=20.0, metavar="S", help="simulated time [20]")
    p.add_argument("--out", type=picture, metavar="FILE", help="picture [step-VEHICLE.png]")
    args = p.parse_args(argv)
    name = Path(args.vehicle).stem
    file = args.out or Path(f"step-{name}.png")
    runtime.init(precision="f64", threads=1)
    refuse_unwritable(file.parent)
    found = errors(StepSetting(args.vehicle, args.seconds), STEPS, FINE)
    largest = load_vehicle(args.vehicle, SHORT).longest_step
    print("\n".join(lines(name, found, largest)))
    draw(name, found, file)
    print(file)


if __name__ == "__main__":
    sys.exit(main())
