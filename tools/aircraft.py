"""Fly an aircraft file on paper: trim over its airspeeds, natural modes; V-n diagram, or hover and control loops.

    python tools/aircraft.py AIRCRAFT [--airspeed V] [--climb DEG] [--radius R] [--set KEY=VALUE ...] [--out FILE]

    python tools/aircraft.py aerosonde
    python tools/aircraft.py aerosonde --set longitudinal.C_D_p=0 --set longitudinal.C_D_delta_e=0.0135
    python tools/aircraft.py zagi --climb 3 --radius 80 --out zagi.png
    python tools/aircraft.py x500 --airspeed 8 --out x500.png

AIRCRAFT is a vehicle file, or the name of a shipped one. Trims are straight and level unless --climb (deg) or
--radius (m, positive to the right) say otherwise; the modes are about the trim at --airspeed (m/s; default: cruise).
The V-n diagram has the wing's largest load factor up to the limit ones of the file, and the airspeeds where they meet.
Of a multirotor: hover with its power, trims, modes with the rotors held (default: in hover), gains and bandwidths of
its controller's loops; the picture has power and tilt over airspeed.

Exit status: 0 done, 2 bad input, or no trim at the airspeed of the modes.
"""

import argparse
import math
import sys
import tomllib
from pathlib import Path

import numpy as np

from taichi_sim.applications.trials import rotorcraft
from taichi_sim.config import ConfigError
from taichi_sim.config.io import config_folder, read_toml, validate
from taichi_sim.errors import command
from taichi_sim.kernels import runtime
from taichi_sim.models.uav.fixed_wing.airframe_arrays import FlightEnvelope, flight_envelope
from taichi_sim.models.uav.fixed_wing.params import FixedWingParams
from taichi_sim.models.uav.fixed_wing.trim import TrimError, largest_stable_dt, linear_modes, trim
from taichi_sim.models.uav.multirotor.params import MultirotorParams
from taichi_sim.options import PICTURES, picture

MODEL = "fixed_wing_6dof"
PARAMS = {MODEL: FixedWingParams, rotorcraft.MODEL: MultirotorParams}
ROWS = 11  # airspeeds of the trim table and of the V-n table
BISECTIONS = 30  # for the airspeeds at which trims end
SLOWEST = 0.9  # first row of the trim table in stall airspeeds, to show why it cannot trim there
CURVE, LIMIT, CRUISE = "#0072B2", "#D55E00", "#22313F"


def load_aircraft(name: str, overrides: list[str]) -> FixedWingParams | MultirotorParams:
    """The parameters of a vehicle file or of a shipped vehicle, with KEY=VALUE overrides."""
    shipped = config_folder() / "vehicles" / f"{Path(name).stem}.toml"
    file = Path(name) if Path(name).suffix == ".toml" and Path(name).is_file() else shipped
    known = [f.stem for f in sorted(shipped.parent.glob("*.toml")) if read_toml(f).get("model") in PARAMS]
    if not file.is_file():
        raise ConfigError(f"{name}: no such aircraft; shipped are {', '.join(known)}, or give a path to a .toml")
    data = read_toml(file)
    model = data.pop("model", None)
    if model not in PARAMS:
        raise ConfigError(f"{file}: not a {' or '.join(PARAMS)}; shipped ones are {', '.join(known)}")
    for text in overrides:
        section, dot, key = text.partition("=")[0].strip().partition(".")
        try:
            value = tomllib.loads(f"value = {text.partition('=')[2]}")["value"]
        except tomllib.TOMLDecodeError:
            value = None
        if not dot or not key or value is None or not isinstance(data.setdefault(section, {}), dict):
            raise ConfigError(f"--set {text}: expected SECTION.KEY=VALUE, for example --set longitudinal.C_D_p=0")
        data[section][key] = value
    return validate(PARAMS[model], data, str(file))


def trim_table(p: FixedWingParams, bounds: FlightEnvelope, gamma: float, radius: float | None) -> str:
    """Trims over the airspeeds of the envelope; where there is none, the row gives the reason."""
    lines = [
        f"{'m/s':>7}{'alpha':>9}{'theta':>9}{'bank':>9}{'slip':>9}{'elevator':>10}{'aileron':>9}{'rudder':>9}"
        f"{'throttle':>10}{'thrust':>10}"
    ]
    flown: list[float] = []
    for Va in np.linspace(SLOWEST * bounds.stall, bounds.top, ROWS):
        try:
            t = trim(p, float(Va), gamma, turn_radius=radius)
        except TrimError as error:
            lines.append(f"{Va:7.2f}   {str(error).split(': ', 1)[1]}")
            continue
        angles = np.degrees([t.alpha, t.theta, t.phi, t.beta, t.elevator, t.aileron, t.rudder]) + 0.0
        alpha, theta, phi, beta, elevator, aileron, rudder = angles
        lines.append(
            f"{Va:7.2f}{alpha:9.3f}{theta:9.3f}{phi:9.3f}{beta:9.3f}{elevator:10.3f}{aileron:9.3f}{rudder:9.3f}"
            f"{t.throttle:10.4f}{t.thrust:10.3f}"
        )
        flown.append(float(Va))
    if flown:
        pitch = (bounds.top - SLOWEST * bounds.stall) / (ROWS - 1)  # between two rows
        low, high = (
            _edge(p, gamma, radius, speed, speed + step) for speed, step in ((flown[0], -pitch), (flown[-1], pitch))
        )
        lines.append(f"steady flight from {low:.2f} to {min(high, bounds.top):.2f} m/s")
    return "\n".join(lines)


def _edge(p: FixedWingParams, gamma: float, radius: float | None, good: float, bad: float) -> float:
    """The airspeed (m/s) at which trims end, between `good`, which trims, and `bad`; `bad` if it trims too."""

    def trims(speed: float) -> bool:
        try:
            trim(p, speed, gamma, turn_radius=radius)
        except TrimError:
            return False
        return True

    if trims(bad):
        return bad
    for _ in range(BISECTIONS):
        middle = (good + bad) / 2
        good, bad = (middle, bad) if trims(middle) else (good, middle)
    return good


def envelope_table(bounds: FlightEnvelope) -> str:
    """The V-n diagram as a table."""
    lines = [
        f"C_L from {bounds.C_L_min:.3f} to {bounds.C_L_max:.3f}; stall {bounds.stall:.2f} m/s, corner "
        f"{bounds.corner:.2f} m/s, inverted corner {bounds.inverted_corner:.2f} m/s, at most {bounds.top:.2f} m/s",
        f"{'m/s':>7}{'n least':>10}{'n largest':>11}",
    ]
    corners = (bounds.stall, bounds.corner, bounds.inverted_corner)
    airspeeds = sorted({*np.linspace(0.0, bounds.top, ROWS).tolist(), *(v for v in corners if v < bounds.top)})
    return "\n".join([*lines, *(f"{v:7.2f}{bounds.least(v) + 0.0:10.3f}{bounds.largest(v):11.3f}" for v in airspeeds)])


def draw(bounds: FlightEnvelope, cruise: float, title: str, file: Path) -> None:
    """Draw the V-n diagram."""
    from taichi_sim.visualisation.plotting import dress, new_figure

    figure = new_figure(8.0, 5.0, title)
    axes = figure.subplots()
    Va = np.linspace(0.0, bounds.top, 400)
    upper, lower = bounds.largest(Va), bounds.least(Va)
    axes.fill_between(Va, lower, upper, color=CURVE, alpha=0.12)
    axes.plot(Va, upper, color=CURVE, label="what the wing bears and may bear")
    axes.plot(Va, lower, color=CURVE)
    axes.plot([bounds.top] * 2, [lower[-1], upper[-1]], color=LIMIT, label=f"at most {bounds.top:g} m/s")
    axes.plot([cruise], [1.0], "o", color=CRUISE, label=f"cruise {cruise:g} m/s")
    for v, n, name in ((bounds.stall, 1.0, "stall"), (bounds.corner, bounds.n_max, "corner")):
        axes.annotate(f"{name} {v:.1f} m/s", (v, n), (-4, 6), textcoords="offset points", ha="right", fontsize=9)
    axes.axhline(0.0, color=CRUISE, linewidth=0.6)
    dress(axes, "V-n diagram", "airspeed, m/s", "load factor n, 1")
    axes.legend(loc="upper left", frameon=False)
    figure.savefig(file, dpi=150)


def parser() -> argparse.ArgumentParser:
    """The arguments."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("aircraft", metavar="AIRCRAFT", help="vehicle file, or the name of a shipped vehicle")
    p.add_argument("--airspeed", type=float, help="airspeed for the modes, m/s (default: cruise)")
    p.add_argument("--climb", type=float, default=0.0, metavar="DEG", help="angle of climb of the trims")
    p.add_argument("--radius", type=float, metavar="M", help="radius of the turn, positive to the right")
    p.add_argument("--set", dest="overrides", action="append", default=[], metavar="KEY=VALUE",
                   help="override SECTION.KEY")  # fmt: skip
    p.add_argument("--out", type=picture, metavar="FILE", help=f"draw the diagram here ({', '.join(PICTURES)})")
    return p


def report(args: argparse.Namespace) -> str:
    """Draw if asked; return the text to print."""
    p = load_aircraft(args.aircraft, args.overrides)
    if isinstance(p, MultirotorParams):
        if args.radius is not None:
            raise ConfigError("--radius: a multirotor turns on the spot; leave it out")
        return rotorcraft.report(args.aircraft, p, args.airspeed, args.climb, args.out)
    gamma, bounds = math.radians(args.climb), flight_envelope(p)
    airspeed = p.envelope.airspeed if args.airspeed is None else args.airspeed
    at = trim(p, airspeed, gamma, turn_radius=args.radius)
    flight = f"climb {args.climb:g} deg" + (f", radius {args.radius:g} m" if args.radius else "")
    parts = [f"{args.aircraft}: trim, {flight}; angles in deg, thrust in N", trim_table(p, bounds, gamma, args.radius)]
    modes = rotorcraft.mode_table(linear_modes(p, at).modes.values(), largest_stable_dt(p, at))
    parts += [f"\nmodes at {at.airspeed:g} m/s, {flight}", modes]
    parts += ["\nV-n diagram", envelope_table(bounds)]
    if args.out:
        draw(bounds, p.envelope.airspeed, Path(args.aircraft).stem, args.out)
    return "\n".join(parts)


@command("aircraft.py")
def main(argv: list[str] | None = None) -> None:
    """Run the command."""
    args = parser().parse_args(argv)
    runtime.init(precision="f64", threads=1)
    print(report(args))


if __name__ == "__main__":
    sys.exit(main())
