"""Fit numbers of a vehicle file to logs of a vessel's motion.

    taichi-sim fit VEHICLE LOG... [--numbers KEY,KEY...] [--prior KEY=SHARE] [--out FILE] [--report FILE]
    taichi-sim fit VEHICLE --synthetic DIR [--factor KEY=X ...]      # makes logs to try it on

    taichi-sim fit otter_3dof --synthetic logs --factor X_u=1.2 --factor surge_force_max=0.9
    taichi-sim fit otter_3dof logs/*.csv --prior mass=0.02 --out mine.toml --report fit.html
    taichi-sim fit otter_3dof run.mcap --name usv_0 --test other.mcap
    taichi-sim fit mine.toml 00000012.bin --channels left=1,right=3
    taichi-sim fit otter 00000012.bin --set 'actions="left_right"' --numbers rigid_body.mass,hydrodynamics.linear.0

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
import json
import re
import shutil
import sys
import tempfile
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from taichi_sim.applications.commands.trials import changes_of
from taichi_sim.applications.fit.estimate import LOST, STARTS, Fit, fit
from taichi_sim.applications.fit.log import Log, read_columns, read_log
from taichi_sim.applications.fit.log_table import CHANNELS, Source
from taichi_sim.applications.fit.sample_selection import SENSORS
from taichi_sim.applications.fit.synthetic_logs import write_logs
from taichi_sim.applications.fit.windows import SECONDS, members, window_seconds
from taichi_sim.config import ConfigError, TeamConfig
from taichi_sim.config.io import replacing, vehicle_file
from taichi_sim.errors import command, named
from taichi_sim.kernels import runtime
from taichi_sim.kernels.rigid_body import changed_mass
from taichi_sim.models.catalogue import load_vehicle, vehicle_files
from taichi_sim.models.usv.hull.hull_6dof import Hull6Dof
from taichi_sim.models.usv.hull.params import CROSS_FLOW
from taichi_sim.models.usv.manoeuvring_3dof import Manoeuvring3dof
from taichi_sim.models.usv.vessel_base import Vessel
from taichi_sim.options import option, output, output_folder, parser_of, ranged, seed
from taichi_sim.vehicle import Vehicle, value_at

PRIOR = 0.4  # prior standard deviation of a number's logarithm; assumed
PRIORS = {"mass": 0.02}  # a vessel can be weighed; assumed
USUAL: dict[type[Vehicle], tuple[str, ...]] = {
    Manoeuvring3dof: ("mass", "I_z", "X_u", "X_uu", "X_uuu", "Y_v", "Y_vv", "N_r", "N_rr", "surge_force_max",
                      "yaw_moment_max"),
    Hull6Dof: ("hydrodynamics.linear.0", "hydrodynamics.quadratic.0", "hydrodynamics.linear.1",
               "hydrodynamics.linear.5", "hydrodynamics.quadratic.5", "hydrodynamics.added_mass.1",
               "hydrodynamics.added_mass.5", CROSS_FLOW, "hydrodynamics.lift", "thrusters.lag"),
}  # fmt: skip
SEEN, DELAY = 3.0, 0.005  # a delay is reported from this many deviations, and this many seconds, on
FAR = 4.0  # deviations of a prior beyond which a fitted number is doubtful
CLOSE = 0.95  # correlations of two numbers above this are reported


def _share(text: str) -> tuple[str, float]:
    key, _, value = text.partition("=")
    return key, float(value)


share = option(_share, lambda pair: 0 < pair[1] < 100, "expected KEY=NUMBER above 0, for example mass=0.02")


def numbers_of(model: Vehicle, asked: str, vehicle: str) -> tuple[str, ...]:
    """Keys to fit: those asked for, or the model's usual ones that are not zero."""
    if asked:
        return tuple(key.strip() for key in asked.split(","))
    usual = USUAL.get(type(model))
    if usual is None:
        raise ConfigError(f"{vehicle}: name what to fit by --numbers; it may be {', '.join(model.varying)}")
    there = {name for name, value in model.nominal.items() if value != 0.0}
    return tuple(key for key in usual if any(name == key or name.startswith(f"{key}.") for name in there))


def lines(found: Fit, logs: list[Log]) -> list[str]:
    """The printed lines."""
    wide = max(map(len, found.keys)) + 2
    told = [f"  {'':{wide}}{'file':>12}{'fitted':>12}{'95 % interval':>28}"]
    for key, before, value, low, high, known in zip(found.keys, found.nominal, found.values, found.low, found.high,
                                                     found.told, strict=True):  # fmt: skip
        note = "" if known else "  the data do not tell it: as believed before"
        told.append(f"  {key:{wide}}{before:12.5g}{value:12.5g}{low:14.5g}{high:14.5g}{note}")
    far = [f"{key} ({times:+.1f})" for key, times in zip(found.keys, found.surprise, strict=True) if abs(times) > FAR]
    if far:
        told.append(f"  FAR FROM THE FILE, in deviations of what is believed beforehand: {', '.join(far)}.")
        told.append("  Is a unit of the logs wrong (feet, degrees, a faster clock), or are they of another vehicle?")
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
    told += [f"  {line}" for line in (*of_delays(found, logs), *of_dependence(found), *found.left_out)]
    if found.odd:
        told.append("  logs of one boat would not ask for such different numbers (another boat, load or sea?):")
    for log, change in found.odd.items():
        asked = ", ".join(f"{found.keys[k]} {100 * np.expm1(change[k]):+.0f} %" for k in _largest(change)[:3])
        told.append(f"    {logs[log].name}: {asked}")
    told.append(f"  {of_held_out(found)}")
    for test in found.tests:
        told.append(f"  test {test.log.name}: {_rms(test.by_file)} by the file, {_rms(test.by_fit)} by the fit")
    return told


def of_delays(found: Fit, logs: Sequence[Log]) -> list[str]:
    """A line for each log whose instruments are early or late."""
    told = []
    for log, delays, deviations in zip(logs, found.delays, found.delay_deviations, strict=True):
        seen = [f"{name} {delay:+.3f} s" for name, delay, deviation in zip(SENSORS, delays, deviations, strict=True)
                if abs(delay) > max(SEEN * deviation, DELAY)]  # fmt: skip
        if seen:
            told.append(f"{log.name}: behind the commands are {', '.join(seen)}")
    return told


def of_dependence(found: Fit) -> list[str]:
    """A line on channels whose residuals depend on each other."""
    wide = [f"{name} {x:.2f}" for name, x in zip(CHANNELS, found.spread, strict=True) if x > 1.05]
    return [f"residuals depend on those before them; their deviations count times {', '.join(wide)}"] if wide else []


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


def written(file: Path, values: Mapping[str, tuple[Any, str]]) -> str:
    """The text of a vehicle file with `values`: key -> value, and what to say of it."""
    text = file.read_text(encoding="utf-8")
    for key, (value, note) in values.items():
        *sections, last = key.split(".")
        if last.isdigit():  # an element of a list
            *sections, last = sections
            whole = list(value_at(tomllib.loads(text), ".".join([*sections, last])))
            whole[int(key.rpartition(".")[2])] = value
            value = whole
        text = _put(text, ".".join(sections), last, f"{last} = {_toml(value)}{f'  # {note}' if note else ''}")
        try:
            found = value_at(tomllib.loads(text), ".".join([*sections, last]))
        except (tomllib.TOMLDecodeError, KeyError, TypeError):
            found = None
        if found is None or _toml(found) != _toml(value):
            raise ConfigError(f"{file}: no line {last} = ... under [{'.'.join(sections)}] to write {key} into: give it "
                              "one, or leave out --out")  # fmt: skip
    return text


def _put(text: str, section: str, key: str, line: str) -> str:
    """The text of a TOML file with `line` in the place of a section's `key`, or after the section's header."""
    begin, end = 0, len(text)
    if section:
        header = re.search(rf"^\[{re.escape(section)}\][^\n]*\n?", text, re.M)
        if header is None:
            return f"{text.rstrip()}\n\n[{section}]\n{line}\n"
        begin = header.end()
    if following := re.compile(r"^\[", re.M).search(text, begin):
        end = following.start()
    found = re.compile(rf"^{re.escape(key)}[ \t]*=[ \t]*", re.M).search(text, begin, end)
    if found is None:
        return f"{text[:begin]}{line}\n{text[begin:]}"
    last, depth = found.end(), 0
    while last < end and (depth or text[last] != "\n"):
        if text[last] == "#":
            last = text.find("\n", last) % (len(text) + 1)
            continue
        depth += {"[": 1, "]": -1}.get(text[last], 0)
        last += 1
    return text[: found.start()] + line + text[last:]


def _toml(value: Any) -> str:
    """A value of a vehicle file as TOML."""
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_toml, value))}]"
    if isinstance(value, float):
        return repr(value)
    return json.dumps(value)


def _flat(changes: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    """Changed values by their whole keys."""
    found = {}
    for key, value in changes.items():
        found |= _flat(value, f"{before}{key}.") if isinstance(value, dict) else {f"{before}{key}": value}
    return found


def values_of(
    model: Vehicle, keys: Sequence[str], numbers: Sequence[float], notes: Sequence[str]
) -> dict[str, tuple[Any, str]]:
    """What a vehicle file with these numbers (of sections: factors) says: key -> value and note. A published M_rb
    follows mass and CG.
    """
    found: dict[str, tuple[Any, str]] = {
        name: (float(f"{x if name == key else x * value:.8g}"), n)
        for key, x, n in zip(keys, numbers, notes, strict=True)
        for name, value in members(model, key).items()
    }
    body = getattr(model.params, "rigid_body", None)
    if body is not None and body.M_rb is not None and any(key.startswith("rigid_body.") for key in keys):
        of = {key.removeprefix("rigid_body."): value for key, (value, _) in found.items()}
        cg = tuple(of.get(f"cg.{k}", body.cg[k]) for k in range(3))
        other = body.model_copy(update={"mass": of.get("mass", body.mass), "cg": cg})
        M = changed_mass(body.M_rb, body.mass, body.cg, other.mass, other.cg)
        found["rigid_body.M_rb"] = ([[float(x) for x in row] for row in M], "follows mass and CG")
    return found


def save(
    out: Path, file: Path, model: Vehicle, found: Fit, logs: Sequence[Log], changes: Mapping[str, Any]
) -> None:  # fmt: skip
    """Write a vehicle file with the fitted numbers, their intervals and where they come from; print what is written."""
    today = datetime.date.today().isoformat()
    known = [k for k, told in enumerate(found.told) if told]
    times = ["" if key in model.varying else " times what it was" for key in found.keys]
    notes = [f"fitted {today}; 95 %: {found.low[k]:.5g} to {found.high[k]:.5g}{times[k]}" for k in known]
    fitted = values_of(model, [found.keys[k] for k in known], [found.values[k] for k in known], notes)
    text = written(file, {key: (value, "") for key, value in _flat(changes).items()} | fitted)
    of = "".join(f"#   {log.name}, sha256 {log.digest}\n" for log in logs)
    for beside in vehicle_files(file)[1:]:
        if not (copy := out.parent / beside.name).exists():
            print(shutil.copy(beside, copy))
    with replacing(out) as part:
        part.write_text(f"# Numbers marked as fitted are of {today}, from\n{of}{text}", encoding="utf-8")
        load_vehicle(part, source=out)
    print(out)


def check_out(out: Path, file: Path, model: Vehicle, keys: Sequence[str], changes: Mapping[str, Any]) -> None:
    """Before the search: whether a vehicle file with fitted `keys`, written to `out`, can be read again."""
    nominal = values_of(model, keys, [members(model, key).get(key, 1.0) for key in keys], [""] * len(keys))
    text = written(file, {key: (value, "") for key, value in _flat(changes).items()} | nominal)
    with tempfile.TemporaryDirectory() as folder:
        for beside in vehicle_files(file)[1:]:
            shutil.copy(beside, folder)
        trial = Path(folder) / f"{out.stem}.toml"
        trial.write_text(text, encoding="utf-8")
        again = load_vehicle(trial, source=file)
    for key in (name for of in keys for name in members(model, of)):
        if not np.isclose(again.nominal[key], model.nominal[key], rtol=1e-6):
            raise ConfigError(f"{file}: {key} = {model.nominal[key]:g} is {again.nominal[key]:g} after writing it: it "
                              "follows from other keys; leave out --out")  # fmt: skip


def parser() -> argparse.ArgumentParser:
    """The parser of the arguments."""
    p = parser_of(__doc__, "taichi-sim fit")
    p.add_argument("vehicle", metavar="VEHICLE", help="vehicle file, or the name of a shipped one")
    p.add_argument("logs", nargs="*", type=Path, metavar="LOG", help="CSV, bag of ROS 2, ArduPilot's .bin")
    p.add_argument("--numbers", default="", metavar="KEY,...",
                   help="numbers to fit; those of a section share a factor [the usual ones of the model]")  # fmt: skip
    p.add_argument("--prior", action="append", type=share, default=[], metavar="KEY=SHARE",
                   help=f"how well it is known beforehand [{PRIOR:g}; mass {PRIORS['mass']:g}]")  # fmt: skip
    p.add_argument("--set", dest="overrides", action="append", default=[], metavar="KEY=VALUE",
                   help="override KEY or SECTION.KEY of the vehicle file; several times")  # fmt: skip
    p.add_argument("--window", type=ranged(float, 1.0, 600.0), metavar="S",
                   help=f"length of a simulated window [{SECONDS:g}, longer where a sensor is slow]")  # fmt: skip
    p.add_argument("--starts", type=ranged(int, 1, 64), default=STARTS, metavar="N",
                   help=f"searches, all but one from draws of the priors [{STARTS}]")  # fmt: skip
    p.add_argument("--test", action="append", type=Path, default=[], metavar="LOG",
                   help="a log that is not fitted, but simulated with the fitted numbers; may be repeated")  # fmt: skip
    p.add_argument("--columns", type=Path, metavar="FILE",
                   help='TOML: columns of other names, NAME = "COLUMN" or ["COLUMN", FACTOR]')  # fmt: skip
    p.add_argument("--name", default="", help="vehicle of a bag, for example usv_0 [the only one]")
    p.add_argument("--channels", default="", metavar="NAME=N,...",
                   help="servo channels of a .bin, -N reversed [by its SERVOn_FUNCTION]")  # fmt: skip
    p.add_argument("--out", type=output, metavar="FILE", help="write the vehicle file with the fitted numbers here")
    p.add_argument("--report", type=output, metavar="FILE", help="write numbers, tracks, residuals as a page of HTML")
    p.add_argument("--synthetic", type=output_folder, metavar="DIR", help="make logs of the vehicle instead")
    p.add_argument("--factor", action="append", type=share, default=[], metavar="KEY=X",
                   help="factor of a number in these logs")  # fmt: skip
    p.add_argument("--count", type=ranged(int, 1, 1000), default=10, help="number of synthetic logs [10]")
    p.add_argument("--seed", type=seed, default=0, help="seed of synthetic logs [0]")
    return p


def run(args: argparse.Namespace) -> None:
    """Fit and print, or make logs."""
    file = vehicle_file(TeamConfig(vehicle=str(args.vehicle)))
    changes = changes_of(args.overrides)
    model = load_vehicle(args.vehicle, **changes)
    if not isinstance(model, Vessel):
        raise ConfigError(f"{args.vehicle}: only vessels can be fitted")
    if args.synthetic is not None:
        factors = dict(args.factor) or {numbers_of(model, args.numbers, args.vehicle)[0]: 1.0}
        asked = {"count": args.count, "seed": args.seed, "changes": changes}
        for made in write_logs(args.vehicle, factors, args.synthetic, **asked):
            print(made)
        return
    if not args.logs:
        raise ConfigError("no logs: name some, or make some by --synthetic DIR")
    keys = numbers_of(model, args.numbers, args.vehicle)
    asked = dict(args.prior)
    if unknown := sorted(set(asked) - set(keys)):
        raise ConfigError(f"--prior {unknown[0]}: it is not fitted; fitted are {', '.join(keys)}")
    with named(f"{args.vehicle}: ", ConfigError):
        for key in keys:
            members(model, key)
    if args.out is not None:
        check_out(args.out, file, model, keys, changes)
    given = {key: PRIORS[key.rpartition(".")[2]] for key in keys if key.rpartition(".")[2] in PRIORS} | asked
    source = Source(read_columns(args.columns) if args.columns else {}, args.name, args.channels)
    logs, tests = ([read_log(log, model, source) for log in files] for files in (args.logs, args.test))
    for k, log in enumerate(every := [*logs, *tests]):
        if log.digest in {other.digest for other in every[:k]}:
            raise ConfigError(f"{log.name} is given twice")
    priors = {key: given.get(key, PRIOR) for key in keys}
    for log in every:
        for note in log.notes:
            print(f"{log.name}: {note}", flush=True)
    seconds = args.window or window_seconds(logs)
    if args.window is None and seconds > SECONDS:
        print(f"a sensor is slow: windows of {seconds:g} s", flush=True)
    found = fit(args.vehicle, logs, priors, seconds=seconds, starts=args.starts, tests=tests, changes=changes)
    print("\n".join([f"{args.vehicle}, {len(logs)} logs", *lines(found, logs)]))
    if args.report is not None:
        from taichi_sim.applications.commands.fit_page import page_of  # matplotlib takes a second

        text = page_of(args.vehicle, found, logs, of_held_out(found), of_starts(found))
        args.report.write_text(text, encoding="utf-8")
        print(args.report)
    if args.out is not None:
        save(args.out, file, model, found, logs, changes)


@command("fit")
def main(argv: list[str] | None = None) -> None:
    """Run the command."""
    args = parser().parse_intermixed_args(argv)  # options may stand between VEHICLE and the logs
    runtime.init(precision="f64", threads=1)
    run(args)


if __name__ == "__main__":
    sys.exit(main())
