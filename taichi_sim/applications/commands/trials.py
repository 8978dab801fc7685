"""Put a vehicle through the standard trials of its kind, and report.

    taichi-sim trials VEHICLE [--trial NAME ...] [--out DIR] [options]

    taichi-sim trials kvlcc2 --scale 45.7
    taichi-sim trials otter --ahead 0.6 --sea hs=0.5,tp=4,direction_deg=90 --runs 16
    taichi-sim trials cybership2 --trial turning --trial zigzag20_20 --ahead 0.5 --helm 0.2
    taichi-sim trials aerosonde
    taichi-sim trials x500 --trial hover --trial terminal

VEHICLE is a vehicle file, or the name of a shipped one. Vessels: turning circle to both sides, zigzags 10/10 and 20/20,
spiral, pull-out, crash stop, speed, roll decay; fixed wings: stall and level flight, climb, glide, turn, natural modes;
multirotors: hover, climb, level flight. Written to DIR: report.html, figures.csv (SI, angles in rad), a CSV of the
curves of each trial, and criteria.csv, IMO's limits (MSC.137(76)) beside a vessel's figures. More: docs/trials.md.

Exit status: 0 done, 2 bad input, or a trial asked for by name that the craft cannot do.
"""

import argparse
import csv
import math
import sys
import time
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from taichi_sim.applications.trials import flight, ship
from taichi_sim.applications.trials.basin import Setting
from taichi_sim.applications.trials.results import Outcome, TrialError, TrialsReport, criteria, doubts
from taichi_sim.config import AirConfig, ConfigError, SeaConfig, Strict
from taichi_sim.config.base import Table
from taichi_sim.config.io import validate
from taichi_sim.errors import command
from taichi_sim.kernels import runtime
from taichi_sim.models.catalogue import Changes, load_vehicle
from taichi_sim.models.uav.fixed_wing.params import FixedWingParams
from taichi_sim.models.uav.multirotor.params import MultirotorParams
from taichi_sim.models.usv.vessel_base import Vessel
from taichi_sim.options import output_folder, parser_of, positive_int, ranged, refuse_unwritable, seed
from taichi_sim.vehicle import Vehicle

ARGUMENTS = ("file", "dt", "substeps", "source")  # of load_vehicle, which the commands give
VESSELS: dict[str, Callable[[Setting], Outcome]] = {
    "turning": ship.turning_circle,
    "zigzag10_10": lambda setting: ship.zigzag(setting, 10.0, 10.0),
    "zigzag20_20": lambda setting: ship.zigzag(setting, 20.0, 20.0),
    "spiral": ship.spiral,
    "pull_out": ship.pull_out,
    "stop": ship.crash_stop,
    "speed": ship.speed_run,
    "roll": ship.roll_decay,
}
WINGS: dict[str, Callable[[FixedWingParams], Outcome]] = {
    "stall": flight.stall, "climb": flight.climb, "glide": flight.glide, "turn": flight.turn, "modes": flight.modes,
}  # fmt: skip
ROTORS: dict[str, Callable[[MultirotorParams], Outcome]] = {
    "hover": flight.hover, "climb": flight.rise, "terminal": flight.terminal,
}  # fmt: skip


def pairs(text: str) -> Table:
    """TOML values from a text KEY=VALUE,KEY=VALUE; a key may be SECTION.KEY."""
    try:
        return tomllib.loads(f"values = {{{text}}}")["values"]
    except tomllib.TOMLDecodeError:
        raise ConfigError(
            f"{text!r}: expected KEY=VALUE,... in TOML (quote strings), for example hs=0.5,tp=4"
        ) from None


def changes_of(overrides: Sequence[str]) -> Changes:
    """Changed values of a vehicle file from texts KEY=VALUE or SECTION.KEY=VALUE."""
    found: Changes = {}
    for text in overrides:
        key, _, value = text.partition("=")
        *sections, last = key.strip().split(".")
        if not sections and last in ARGUMENTS:
            told = "the step here is the command's own" if last == "dt" else "no key of a vehicle file"
            raise ConfigError(f"--set {text}: {told}")
        try:
            parsed = tomllib.loads(f"value = {value}")["value"]
        except tomllib.TOMLDecodeError:
            raise ConfigError(
                f"--set {text}: expected KEY=VALUE or SECTION.KEY=VALUE in TOML (quote strings), for example "
                "--set rudder.rate_deg=5 or --set 'actions=\"left_right\"'"
            ) from None
        table = found
        for section in sections:
            if not isinstance(table.setdefault(section, {}), dict):
                raise ConfigError(f"--set {text}: {section} is a value, not a section")
            table = table[section]
        table[last] = parsed
    return found


def conditions_of(args: argparse.Namespace) -> tuple[SeaConfig | None, AirConfig | None, str]:
    """Sea, air, and a description of both."""
    sea, air, told = None, None, []
    data = {} if args.sea is None else pairs(args.sea)
    if args.sea is not None:
        told.append(f"sea {args.sea}")
    if args.current is not None:
        data = data or {"hs": 0.0, "tp": 4.0}
        data["current"] = {"speed": args.current[0], "direction_deg": args.current[1]}
        told.append(f"current {args.current[0]:g} m/s to {args.current[1]:g} deg")
    if data:
        sea = validate(SeaConfig, data, "--sea")
    if args.wind is not None:
        air = validate(AirConfig, {"speed": args.wind[0], "direction_deg": args.wind[1]}, "--wind")
        told.append(f"wind {args.wind[0]:g} m/s from {args.wind[1]:g} deg")
    if told:
        told.append(f"approach at {args.heading:g} deg")
    return sea, air, ", ".join(told) or "calm"


def kind_of(model: Vehicle, vehicle: str) -> tuple[str, Mapping[str, Callable[..., Outcome]]]:
    """The kind of a craft, and its trials by name."""
    if isinstance(model, Vessel):
        return "vessel", VESSELS
    if isinstance(model.params, FixedWingParams):
        return "fixed wing", WINGS
    if isinstance(model.params, MultirotorParams):
        return "multirotor", ROTORS
    raise ConfigError(
        f"{vehicle}: there are no trials of a {type(model).__name__}: they are of vessels, fixed_wing_6dof and "
        "multirotor_6dof"
    )


def run(args: argparse.Namespace, shown: Callable[[str], None]) -> TrialsReport:
    """Do all trials that are asked for."""
    sea, air, told = conditions_of(args)
    changes = changes_of(args.overrides)
    model = load_vehicle(args.vehicle, 1e-3, 1, **changes)
    kind, trials = kind_of(model, args.vehicle)
    for name in args.trial:
        if name not in trials:
            raise ConfigError(f"{args.vehicle}: a {kind} has no trial {name!r}; it has {', '.join(trials)}")
    argument: Strict | Setting = model.params
    if kind == "vessel":
        argument = Setting(
            args.vehicle, changes, sea, air, args.runs, math.radians(args.heading), args.ahead, args.helm, args.speed,
            args.dt, args.seed,
        )  # fmt: skip
    elif told != "calm":
        raise ConfigError(f"{args.vehicle}: trials of a {kind} are flights through still air; leave out --sea, --wind "
                          "and --current")  # fmt: skip
    outcomes = []
    for name in args.trial or trials:
        began = time.perf_counter()
        try:
            found = trials[name](argument)
        except TrialError as refusal:
            if args.trial:
                raise
            found = Outcome(name, name.replace("_", " "), refused=str(refusal).removeprefix(f"{args.vehicle}: "))
        outcomes.append(found)
        shown(f"{found.title}: {found.refused or f'{time.perf_counter() - began:.1f} s'}")
    doubted = doubts(outcomes, model.params) if kind == "vessel" else []
    met = criteria(outcomes, model.size[0], args.scale, doubted) if kind == "vessel" else []
    return TrialsReport(Path(args.vehicle).stem, kind, told, outcomes, met, model.size[0], doubted)


def write(report: TrialsReport, folder: Path) -> None:
    """Write the CSV files and the page into `folder`."""
    from taichi_sim.applications.commands.trials_page import page_of

    folder.mkdir(parents=True, exist_ok=True)

    def table(name: str, head: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
        with (folder / f"{name}.csv").open("w", newline="") as file:
            csv.writer(file).writerows([head, *rows])

    figures = ((*f[:4], repr(f.value), f.unit) for out in report.outcomes for f in out.figures)
    table("figures", ("trial", "case", "run", "figure", "value", "unit"), figures)
    for out in report.outcomes:
        samples = ((c.case, row) for c in out.curves for row in np.transpose([*c.columns.values()]))
        if out.curves:
            rows = ((case, *map(repr, map(float, row))) for case, row in samples)
            table(out.name, ("case", *out.curves[0].columns), rows)
    if report.criteria:
        limits = ((*c[:2], repr(c.value), repr(c.limit), c.unit, c.met) for c in report.criteria)
        table("criteria", ("criterion", "case", "value", "limit", "unit", "met"), limits)
    (folder / "report.html").write_text(page_of(report), encoding="utf-8")


def lines(report: TrialsReport) -> list[str]:
    """The printed lines: means over the runs."""
    found = [f"{report.vehicle}, a {report.kind}, {report.conditions}"]
    for out in report.outcomes:
        found.append(f"\n{out.title}" + (f": {out.refused}" if out.refused else ""))
        cases = list(dict.fromkeys(f.case for f in out.figures))
        names = list(dict.fromkeys((f.name, f.unit) for f in out.figures))
        if not cases:
            continue
        wide = max(len(name) for name, _ in names) + 2
        if len(cases) <= 4:
            found.append(" " * (wide + 8) + "".join(f"{case:>16}" for case in cases))
            for name, unit in names:
                told, factor = ("deg", math.degrees(1.0)) if unit == "rad" else (unit, 1.0)
                values = [out.mean(case, name) * factor for case in cases]
                found.append(f"  {name:{wide}}{told:6}" + "".join(f"{value:16.6g}" for value in values))
        else:
            found.append(" " * 12 + "".join(f"{name:>18}" for name, _ in names))
            found += [f"  {case:10}" + "".join(f"{out.mean(case, name):18.6g}" for name, _ in names) for case in cases]
    if report.criteria:
        found.append("\nIMO MSC.137(76)")
        for c in report.criteria:
            factor, unit = (math.degrees(1.0), "deg") if c.unit == "rad" else (1.0, "")
            value, limit = c.value * factor, c.limit * factor
            found.append(f"  {c.judgement:7}  {value:8.3f} of at most {limit:6.2f} {unit:3}  {c.name}, {c.case}")
    if report.doubts:
        found.append("\nNo vessel has these figures: a number of the vehicle file is wrong, or missing")
        found += [f"  {doubt}" for doubt in report.doubts]
    return found


def parser() -> argparse.ArgumentParser:
    """The parser of the arguments."""
    p = parser_of(__doc__, "taichi-sim trials")
    p.add_argument("vehicle", metavar="VEHICLE", help="vehicle file, or the name of a shipped one")
    p.add_argument("--trial", action="append", default=[], metavar="NAME", help="a trial to do; several times [all]")
    p.add_argument("--out", type=output_folder, metavar="DIR", help="folder of the report [trials-VEHICLE]")
    p.add_argument("--set", dest="overrides", action="append", default=[], metavar="KEY=VALUE",
                   help="override KEY or SECTION.KEY of the vehicle file; several times")  # fmt: skip
    p.add_argument("--quiet", action="store_true", help="print no progress")
    v = p.add_argument_group("vessels")
    v.add_argument("--ahead", type=ranged(float, 0.01, 1.0), default=1.0, metavar="SHARE",
                   help="share of full thrust or revolutions [1]")  # fmt: skip
    v.add_argument("--helm", type=ranged(float, 0.01, 1.0), default=1.0, metavar="SHARE",
                   help="share of full helm in turning circles [1]")  # fmt: skip
    v.add_argument("--speed", type=ranged(float, 0.01, 50.0), metavar="V",
                   help="speed of the approach, held as by a carriage, m/s [its own]")  # fmt: skip
    v.add_argument("--scale", type=ranged(float, 1.0, 1000.0), default=1.0, metavar="N",
                   help="scale 1 : N of the model, for IMO's limits [1]")  # fmt: skip
    v.add_argument("--sea", metavar="KEY=VALUE,...",
                   help="keys of [sea], for example hs=0.5,tp=4,direction_deg=90 [calm]")  # fmt: skip
    v.add_argument("--wind", type=float, nargs=2, metavar=("SPEED", "FROM"), help="m/s at 10 m, deg [none]")
    v.add_argument("--current", type=float, nargs=2, metavar=("SPEED", "TO"), help="m/s, deg [none]")
    v.add_argument("--heading", type=float, default=0.0, metavar="DEG",
                   help="heading of the approach, for wind, waves and current [0]")  # fmt: skip
    v.add_argument("--runs", type=positive_int, default=1, metavar="N",
                   help="realisations of the sea, side by side [1]")  # fmt: skip
    v.add_argument("--seed", type=seed, default=1, help="seed of the realisations [1]")
    v.add_argument("--dt", type=ranged(float, 1e-4, 10.0), metavar="S",
                   help="physics step [0.014 s times the root of the length in m]")  # fmt: skip
    return p


@command("trials")
def main(argv: list[str] | None = None) -> None:
    """Run the command."""
    args = parser().parse_args(argv)
    runtime.init(precision="f64", threads=1)
    shown = (lambda _: None) if args.quiet else (lambda words: print(words, file=sys.stderr, flush=True))
    folder = args.out or Path(f"trials-{Path(args.vehicle).stem}")
    refuse_unwritable(folder)
    report = run(args, shown)
    write(report, folder)
    print("\n".join(lines(report)))
    print(f"\n{folder / 'report.html'}")


if __name__ == "__main__":
    sys.exit(main())
