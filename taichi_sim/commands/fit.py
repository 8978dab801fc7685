"""Fit numbers of a vehicle file to logs of a vessel's motion.

    taichi-sim fit VEHICLE LOG... [--numbers KEY,KEY...] [--prior KEY=SHARE] [--out FILE] [--report FILE]
    taichi-sim fit VEHICLE --synthetic DIR [--factor KEY=X ...]      # makes logs to try it on

    taichi-sim fit otter_3dof --synthetic logs --factor X_u=1.2 --factor surge_force_max=0.9
    taichi-sim fit otter_3dof logs/*.csv --prior mass=0.02 --out mine.toml --report fit.html
    taichi-sim fit otter_3dof run.mcap --name usv_0 --test other.mcap
    taichi-sim fit mine.toml 00000012.bin --channels left=1,right=3

VEHICLE is a vehicle file, or the name of a shipped one: its numbers are the first guess. LOG is one of

    a CSV with the columns t, north, east, heading (or heading_deg), yaw_rate (or yaw_rate_deg) and the actions,
    a bag of ROS 2 (.mcap, or a folder) with /NAME/odom and /NAME/actions,
    a dataflash log of ArduPilot (.bin) with XKF1, IMU and RCOU.

Intervals are 95 % intervals. A number that the data do not determine is reported, and keeps the file's value. Method,
assumptions, and what is taken from each kind of log: docs/fit.md.

Exit status: 0 done, 2 bad input.
"""

import argparse
import datetime
import re
import sys
from pathlib import Path

import numpy as np

from taichi_sim.config import ConfigError, TeamConfig
from taichi_sim.config.base import MissingExtraError
from taichi_sim.config.io import vehicle_file
from taichi_sim.fit.estimate import LOST, STARTS, Fit, fit
from taichi_sim.fit.log import Log, read_columns, read_log
from taichi_sim.fit.synthetic import write_logs
from taichi_sim.fit.table import Source
from taichi_sim.kernels import runtime
from taichi_sim.usv.manoeuvring_3dof import Manoeuvring3dof
from taichi_sim.vehicle import Vehicle
from taichi_sim.vehicles import load_vehicle

PRIOR = 0.4  # prior standard deviation of a number's logarithm; assumed
PRIORS = {"mass": 0.02}  # a vessel can be weighed; assumed
USUAL: dict[type[Vehicle], tuple[str, ...]] = {
    Manoeuvring3dof: ("mass", "I_z", "X_u", "X_uu", "X_uuu", "Y_v", "Y_vv", "N_r", "N_rr", "surge_force_max",
                      "yaw_moment_max"),
}  # fmt: skip
CLOSE = 0.95  # correlations of two numbers above this are reported


def shares(texts: list[str], option: str) -> dict[str, float]:
    """Positive numbers from texts KEY=NUMBER.

    Raises:
        ConfigError: for any other text.
    """
    found = {}
    for text in texts:
        key, _, value = text.partition("=")
        try:
            found[key] = float(value)
        except ValueError:
            found[key] = 0.0
        if not 0 < found[key] < 100:
            raise ConfigError(f"{option} {text}: expected KEY=NUMBER above 0, for example {option} mass=0.02")
    return found


def numbers_of(model: Vehicle, asked: str, vehicle: str) -> tuple[str, ...]:
    """Keys to fit: those asked for, or the model's usual ones that are not zero.

    Raises:
        ConfigError: if the model has no usual ones.
    """
    if asked:
        return tuple(key.strip() for key in asked.split(","))
    usual = USUAL.get(type(model))
    if usual is None:
        raise ConfigError(f"{vehicle}: name what to fit by --numbers; it may be {', '.join(model.varying)}")
    return tuple(key for key in usual if model.nominal[key] != 0.0)


def lines(found: Fit, logs: list[Log]) -> list[str]:
    """The printed lines."""
    wide = max(map(len, found.keys)) + 2
    told = [f"  {'':{wide}}{'file':>12}{'fitted':>12}{'95 % interval':>28}"]
    for key, before, value, low, high, known in zip(found.keys, found.nominal, found.values, found.low, found.high,
                                                     found.told, strict=True):  # fmt: skip
        note = "" if known else "  the data do not tell it: as believed before"
        told.append(f"  {key:{wide}}{before:12.5g}{value:12.5g}{low:14.5g}{high:14.5g}{note}")
    for change in found.unknown:
        together = ", ".join(f"{found.keys[k]} {100 * np.expm1(change[k]):+.0f} %" for k in _largest(change))
        told.append(f"  the data do not tell these changes, all made together, from none: {together}")
    n = len(found.keys)
    close = [(i, j) for i in range(n) for j in range(i) if abs(found.correlation[i, j]) > CLOSE]
    if close:
        pairs = ", ".join(f"{found.keys[j]} and {found.keys[i]} ({found.correlation[i, j]:+.3f})" for i, j in close)
        told.append(f"  hard to tell apart (correlation): {pairs}")
    told += [f"  {line}" for line in of_starts(found)]
    north, east, heading, rate = *found.sigma[:2], *np.degrees(found.sigma[2:])
    told.append(f"  errors of measurement: {north:.3g} and {east:.3g} m, {heading:.3g} deg, {rate:.3g} deg/s")
    for log, (north, east) in zip(logs, found.currents, strict=True):
        towards = np.degrees(np.arctan2(east, north)) % 360
        told.append(f"  {log.name}: current {np.hypot(north, east):.2f} m/s to {towards:.0f} deg")
    if found.odd:
        told.append("  logs of one boat would not ask for such different numbers (another boat, load or sea?):")
    for log, change in found.odd.items():
        asked = ", ".join(f"{found.keys[k]} {100 * np.expm1(change[k]):+.0f} %" for k in _largest(change)[:3])
        told.append(f"    {logs[log].name}: {asked}")
    told.append(f"  {of_held_out(found)}")
    for test in found.tests:
        told.append(f"  test {test.log.name}: {_rms(test.by_file)} by the file, {_rms(test.by_fit)} by the fit")
    return told


def of_held_out(found: Fit) -> str:
    """A line on the residuals of the windows that were not fitted."""
    if np.isnan(found.after):
        return "no window was held out, there are too few: give longer logs, or a --test"
    return (f"windows that were not fitted: residuals of {found.before:.2f} standard deviations by the file, "
            f"{found.after:.2f} by the fit (1 is the noise)")  # fmt: skip


def _rms(left: np.ndarray) -> str:
    """Residuals rms [4] of position (both components together), heading and yaw rate."""
    heading, rate = np.degrees(left[2:])
    return f"{np.hypot(left[0], left[1]):.3g} m, {heading:.3g} deg, {rate:.3g} deg/s rms"


def _largest(change: np.ndarray) -> list[int]:
    """Indices of the numbers by the size of their `change`, largest first, down to a tenth of the largest change."""
    return [int(k) for k in np.argsort(-np.abs(change)) if abs(change[k]) > 0.1 * np.abs(change).max()]


def of_starts(found: Fit) -> list[str]:
    """Lines on where the searches from several starts have ended."""
    took = f"{found.seconds:.1f} s"
    if found.asked == 1:
        return [f"one start, from the file's numbers: {took}"]
    best, *others = found.starts
    if not others:
        return [f"{found.asked} starts end at the same numbers: {took}"]
    lines = [f"{found.asked} starts end at {len(others) + 1} places, the most likely one is kept: {took}"]
    for other in others:
        apart = other.phi - best.phi
        there = ", ".join(f"{found.keys[k]} {100 * np.expm1(apart[k]):+.0f} %" for k in _largest(apart)[:3])
        why = "a worse local minimum" if other.worse > LOST else "as likely: the data do not tell them apart"
        lines.append(f"  {there}: {why} (logarithm of the likelihood {-other.worse:.1f})")
    return lines


def written(file: Path, found: Fit, logs: list[Log]) -> str:
    """The text of a vehicle file with the fitted numbers, their intervals and where they come from.

    Raises:
        ConfigError: for a number that the text does not have on a line of its own.
    """
    text = file.read_text(encoding="utf-8")
    today = datetime.date.today().isoformat()
    for key, value, low, high, known in zip(found.keys, found.values, found.low, found.high, found.told, strict=True):
        if not known:
            continue
        section, _, last = key.rpartition(".")
        start = 0
        if section:
            place = re.search(rf"^\[{re.escape(section)}\]", text, re.M)
            start = place.end() if place else len(text)
        line = re.compile(rf"^({re.escape(last)}\s*=\s*)[-+0-9.eE_]+[^\n]*$", re.M)
        match = line.search(text, start)
        if match is None:
            raise ConfigError(f"{file}: no line {last} = ... to write {key} into")
        new = f"{match[1]}{value:.8g}  # fitted {today}; 95 %: {low:.5g} to {high:.5g}"
        text = text[: match.start()] + new + text[match.end() :]
    of = "".join(f"#   {log.name}, sha256 {log.digest}\n" for log in logs)
    return f"# Numbers marked as fitted are of {today}, from\n{of}{text}"


def parser() -> argparse.ArgumentParser:
    """The parser of the arguments."""
    summary, _, rest = (__doc__ or "").partition("\n\n")
    p = argparse.ArgumentParser(
        prog="taichi-sim fit", description=summary, epilog=rest, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    p.add_argument("vehicle", metavar="VEHICLE", help="vehicle file, or the name of a shipped one")
    p.add_argument("logs", nargs="*", type=Path, metavar="LOG", help="CSV, bag of ROS 2, ArduPilot's .bin")
    p.add_argument("--numbers", default="", metavar="KEY,...", help="numbers to fit [the usual ones of the model]")
    p.add_argument("--prior", action="append", default=[], metavar="KEY=SHARE",
                   help=f"how well it is known beforehand [{PRIOR:g}; mass {PRIORS['mass']:g}]")  # fmt: skip
    p.add_argument("--window", type=float, default=6.0, metavar="S", help="length of a simulated window [6]")
    p.add_argument("--starts", type=int, default=STARTS, metavar="N",
                   help=f"searches, all but one from draws of the priors [{STARTS}]")  # fmt: skip
    p.add_argument("--test", action="append", type=Path, default=[], metavar="LOG",
                   help="a log that is not fitted, but simulated with the fitted numbers; may be repeated")  # fmt: skip
    p.add_argument("--columns", type=Path, metavar="FILE",
                   help='TOML: columns of other names, NAME = "COLUMN" or ["COLUMN", FACTOR]')  # fmt: skip
    p.add_argument("--name", default="", help="vehicle of a bag, for example usv_0 [the only one]")
    p.add_argument("--channels", default="", metavar="NAME=N,...",
                   help="servo channels of a .bin, -N reversed [by its SERVOn_FUNCTION]")  # fmt: skip
    p.add_argument("--out", type=Path, metavar="FILE", help="write the vehicle file with the fitted numbers here")
    p.add_argument("--report", type=Path, metavar="FILE", help="write numbers, tracks and residuals as a page of HTML")
    p.add_argument("--synthetic", type=Path, metavar="DIR", help="make logs of the vehicle instead")
    p.add_argument(
        "--factor", action="append", default=[], metavar="KEY=X", help="factor of a number in synthetic logs"
    )
    p.add_argument("--count", type=int, default=10, help="number of synthetic logs [10]")
    p.add_argument("--seed", type=int, default=0, help="seed of synthetic logs [0]")
    return p


def run(args: argparse.Namespace) -> None:
    """Fit and print, or make logs.

    Raises:
        ConfigError: for bad input.
    """
    file = vehicle_file(TeamConfig(vehicle=str(args.vehicle)))
    model = load_vehicle(args.vehicle)
    if args.synthetic is not None:
        factors = shares(args.factor, "--factor") or {numbers_of(model, args.numbers, args.vehicle)[0]: 1.0}
        for made in write_logs(args.vehicle, factors, args.synthetic, count=args.count, seed=args.seed):
            print(made)
        return
    if not args.logs:
        raise ConfigError("no logs: name some, or make some by --synthetic DIR")
    keys = numbers_of(model, args.numbers, args.vehicle)
    asked = shares(args.prior, "--prior")
    if unknown := sorted(set(asked) - set(keys)):
        raise ConfigError(f"--prior {unknown[0]}: it is not fitted; fitted are {', '.join(keys)}")
    for target in (args.out, args.report):
        if target is not None and not target.parent.is_dir():
            raise ConfigError(f"{target}: there is no folder {target.parent}")
    given = PRIORS | asked
    source = Source(read_columns(args.columns) if args.columns else {}, args.name, args.channels)
    logs, tests = ([read_log(log, model, source) for log in files] for files in (args.logs, args.test))
    for k, log in enumerate(every := [*logs, *tests]):
        if log.digest in {other.digest for other in every[:k]}:
            raise ConfigError(f"{log.name} is given twice")
    priors = {key: given.get(key, PRIOR) for key in keys}
    found = fit(args.vehicle, logs, priors, seconds=args.window, starts=args.starts, tests=tests)
    print("\n".join([f"{args.vehicle}, {len(logs)} logs", *lines(found, logs)]))
    if args.report is not None:
        from taichi_sim.commands.fit_page import page_of  # matplotlib takes a second

        text = page_of(args.vehicle, found, logs, of_held_out(found), of_starts(found))
        args.report.write_text(text, encoding="utf-8")
        print(args.report)
    if args.out is not None:
        args.out.write_text(written(file, found, logs), encoding="utf-8")
        load_vehicle(args.out)
        print(args.out)


def main(argv: list[str] | None = None) -> int:
    """Run the command; return the exit status."""
    p = parser()
    args = p.parse_args(argv)
    for name, low, high in (("window", 1.0, 600.0), ("count", 1, 1000), ("seed", 0, 2**31 - 1), ("starts", 1, 64)):
        if not low <= getattr(args, name) <= high:
            p.error(f"--{name} {getattr(args, name):g}: allowed are {low:g} to {high:g}")
    runtime.init(precision="f64", threads=1)
    try:
        run(args)
    except (ConfigError, MissingExtraError, ValueError, OSError) as error:
        print(f"fit: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
