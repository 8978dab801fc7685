"""Describe the sea in a file of measured spectra, and test which shipped vessels survive in it.

    python tools/sea_of.py FILE [--time "YYYY-MM-DD hh:mm"] [--site N] [--wind SPEED FROM] [--vessels NAME ...]

    python tools/sea_of.py 41010.data_spec --time "2020-06-08 03:50"
    python tools/sea_of.py era5.nc --site 12 --wind 9 210 --vessels otter

FILE is a file for `sea.spectrum` (docs/seas.md). The tool prints height, periods, direction (where waves come from),
spread, steepness, WMO sea state, and the wave systems that wavespectra's watershed finds (extra `waves`). With --wind
(m/s at 10 m, degrees from), wind sea is the part that this wind drives (Hanson & Phillips 2001); without it, the part
steeper than 1/40. The rest is swell.

Then 64 of each vessel drift without a command for a minute from rest, each in its own realisation and on its own
heading. The tool counts those that capsized (tilted past the angle of vanishing stability) or were swamped (the mean
surface under the hull rose above the deck). A vessel survives if none of them did. Models of three degrees of freedom
do not roll or pitch and are left out.

Exit status: 0 done, 2 bad input.
"""

import argparse
import math
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from tqdm import tqdm

from taichi_sim.bench import pack_state
from taichi_sim.config import SeaConfig, WorldConfig
from taichi_sim.config.io import config_folder, validate
from taichi_sim.errors import command, needs
from taichi_sim.kernels import runtime
from taichi_sim.kernels.conventions import GRAVITY, QUATERNION
from taichi_sim.kernels.rotation import torch_euler_from_quaternion
from taichi_sim.models.catalogue import load_vehicle
from taichi_sim.options import parser_of, ranged, seed
from taichi_sim.surroundings.sea.measured import WaveRecord, open_spectra, records_of
from taichi_sim.surroundings.sea.wind_sea import sea_state
from taichi_sim.world import World

ENVS, DURATION = 64, 60.0  # vessels of each kind; duration, s
LATEST_START = 3600.0  # s, latest time of the sea at which a vessel begins
WORDS = ("calm (glassy)", "calm (rippled)", "smooth", "slight", "moderate", "rough", "very rough", "high", "very high",
         "phenomenal")  # fmt: skip
STEEP = 0.025  # least Hs over the wavelength of Tm-1,0 of wind sea (wavespectra's default)
SWELLS, DIRECTIONS = 3, 36  # largest number of swell systems; directions of the watershed
LEAST = 0.05  # m, least height of a system
DEEP = 1000.0  # m, depth given for deep water


class Fate(NamedTuple):
    """Result of a vessel's trial in a sea: shares that capsized and were swamped; rms of roll and pitch (deg)."""

    capsized: float
    swamped: float
    roll: float
    pitch: float


class System(NamedTuple):
    """A wave system: name, height (m), peak period (s), direction it comes from (deg)."""

    name: str
    hs: float
    tp: float
    comes_from: float


def describe(record: WaveRecord) -> list[str]:
    """Lines that describe a sea."""
    state = sea_state(record.hs)
    lines = [record.name, f"  height       Hs {record.hs:.2f} m, sea state {state} ({WORDS[state]})"]
    if record.calm:
        return lines
    length = GRAVITY / (2 * math.pi)
    return [
        *lines,
        f"  periods      Tp {record.tp:.1f} s; mean Tm01 {record.tm01:.2f} s, Tm02 {record.tm02:.2f} s, "
        f"Tm-1,0 {record.energy_period:.2f} s",
        f"  direction    from {comes_from(record.direction):.0f} degrees on the mean, from "
        f"{comes_from(record.peak_direction):.0f} at the peak",
        f"  spread       {math.degrees(record.circular_deviation):.0f} degrees (circular deviation of all waves)",
        f"  steepness    1/{length * record.tp**2 / record.hs:.0f} by Tp, 1/{length * record.tm02**2 / record.hs:.0f} "
        "by Tm02 (height over wavelength)",
    ]


def comes_from(travels_to: float) -> float:
    """The direction (degrees, 0 to 360) from which waves come that travel to `travels_to` (rad)."""
    return (math.degrees(travels_to) + 180.0) % 360.0


def systems(record: WaveRecord, wind: tuple[float, float] | None = None) -> list[System]:
    """Wind sea and swells by wavespectra's watershed; `wind` is its speed (m/s), and where it blows from (deg)."""
    with needs("wavespectra", "waves"):
        import wavespectra  # noqa: F401
        import xarray
    width = record.spread.shape[1] // DIRECTIONS
    share = record.spread.reshape(len(record.density), DIRECTIONS, width).mean(axis=2)
    angles = np.rad2deg((np.arange(DIRECTIONS) + 0.5) * (2 * np.pi / DIRECTIONS) - np.pi)
    turned = (angles + 180.0) % 360.0
    order = np.argsort(turned)
    energy = np.deg2rad(record.density[:, None] * share[:, order])
    frequency = (record.edges[1:] + record.edges[:-1]) / 2
    sea = xarray.DataArray(energy, coords={"freq": frequency, "dir": turned[order]}, dims=("freq", "dir"), name="efth")
    if wind is None:
        parts = sea.spec.partition.steepness(scut=STEEP, swells=SWELLS, swell_merge="hp01", smooth=True)
    else:
        given = (xarray.DataArray(x) for x in (*wind, DEEP))
        parts = sea.spec.partition.hp01(*given, swells=SWELLS, smooth=True)
    found = []
    for number, part in enumerate(np.asarray(parts.transpose("part", "freq", "dir"))):
        density = part.sum(axis=1) * 360.0 / DIRECTIONS
        hs = 4 * math.sqrt((density * np.diff(record.edges)).sum())
        if hs >= LEAST:
            mean = (part * np.exp(1j * np.deg2rad(turned[order]))).sum(axis=1)
            towards = np.angle((mean * np.diff(record.edges)).sum(), deg=True) % 360.0
            name = "wind sea" if number == 0 else "swell"
            found.append(System(name, hs, 1 / float(frequency[density.argmax()]), towards))
    return found


def fate(vessel: str, sea: SeaConfig, envs: int, duration: float, seed: int, shown: bool = True) -> Fate | None:
    """Let `envs` vessels drift in a sea; None for a model that cannot capsize or be swamped."""
    data = {"seed": seed, "vessel": {"vehicle": vessel, "count": 1, "medium": "water"}}
    config = validate(WorldConfig, data, vessel).model_copy(update={"sea": sea})
    world = World(config, envs)
    fleet = world.teams["vessel"]
    if not math.isfinite(getattr(fleet.model, "deck_height", math.inf)):
        return None
    everywhere = torch.arange(envs, device=fleet.state.device)
    random = np.random.default_rng(seed)
    world.time.copy_(torch.from_numpy(random.random(envs) * LATEST_START))
    headings = 2 * np.pi * (np.arange(envs) + random.random()) / envs
    start = pack_state(np.column_stack((np.zeros((envs, 5)), random.permutation(headings))))
    world.place("vessel", everywhere, torch.from_numpy(start).to(fleet.state).unsqueeze(1))
    still = torch.zeros_like(fleet.action)
    ended = {name: torch.zeros_like(fleet.never) for name in ("capsized", "swamped")}
    squares, steps = torch.zeros(2, dtype=torch.float64), max(1, round(duration / config.decision_interval))
    for _ in tqdm(range(steps), desc=vessel, unit="step", leave=False, disable=not shown):
        world.step({"vessel": still})
        now = fleet.model.endings(fleet, world)
        lost = ~fleet.state.sum(dim=-1).isfinite()
        for name, so_far in ended.items():
            so_far |= now[name] | lost
        angles = torch_euler_from_quaternion(fleet.state[..., QUATERNION].double()).reshape(-1, 3)[:, :2]
        squares += torch.nan_to_num(angles).square().mean(dim=0).cpu() / steps
    roll, pitch = squares.sqrt().rad2deg().tolist()
    return Fate(*(float(x.float().mean()) for x in ended.values()), roll, pitch)


def vessels() -> list[str]:
    """Names of the shipped vehicles that move in water."""
    names = sorted(file.stem for file in (config_folder() / "vehicles").glob("*.toml"))
    return [name for name in names if load_vehicle(name).medium == "water"]


def fate_line(vessel: str, found: Fate | None) -> str:
    """A line about the fate of a vessel."""
    if found is None:
        return f"  {vessel:12} cannot tell: its model neither capsizes nor is swamped"
    survives = "survives" if found.capsized == found.swamped == 0 else "does not"
    return (
        f"  {vessel:12} {survives:9} capsized {found.capsized:4.0%}, swamped {found.swamped:4.0%}; "
        f"roll {found.roll:.1f}, pitch {found.pitch:.1f} degrees rms"
    )


def parser() -> argparse.ArgumentParser:
    """The arguments."""
    p = parser_of(__doc__)
    p.add_argument("file", type=Path, metavar="FILE", help="measured spectra")
    p.add_argument("--time", help="of the record, UTC [the latest]")
    p.add_argument("--site", type=int, help="number of a place in a file that has several")
    p.add_argument("--wind", type=float, nargs=2, metavar=("SPEED", "FROM"), help="m/s at 10 m, degrees it blows from")
    p.add_argument("--direction", type=float, help="degrees waves travel to, of a record without directions")
    p.add_argument("--spreading", type=float, help="s of cos^2s, of a record without directions")
    p.add_argument("--vessels", nargs="*", metavar="NAME", help="vehicle files or names [all shipped]; none: no trial")
    p.add_argument("--envs", type=ranged(int, 1, 4096), default=ENVS, help=f"of each vessel [{ENVS}]")
    p.add_argument("--duration", type=ranged(float, 0.1, 3600.0), default=DURATION, help=f"s [{DURATION:g}]")
    p.add_argument("--seed", type=seed, default=1, help="of the realisations [1]")
    p.add_argument("--quiet", action="store_true", help="no progress bars")
    return p


@command("sea_of")
def main(argv: list[str] | None = None) -> None:
    """Run the command."""
    args = parser().parse_args(argv)
    given = {"record": args.time, "site": args.site, "direction_deg": args.direction, "spreading_s": args.spreading}
    data = {"spectrum": str(args.file), "realisations": args.envs} | {k: v for k, v in given.items() if v is not None}
    runtime.init()
    whole = open_spectra(args.file, args.site)
    sea = validate(SeaConfig, data, str(args.file))
    record = records_of(sea)[0]
    print("\n".join(describe(record)))
    if whole.times.size > 1:
        print(f"  the file     {whole.times.size} records, {whole.times[0]} to {whole.times[-1]} UTC")
    if not record.calm:
        for part in systems(record, tuple(args.wind) if args.wind else None):
            print(f"  {part.name:12} Hs {part.hs:.2f} m, Tp {part.tp:.1f} s, from {part.comes_from:.0f} degrees")
    names = vessels() if args.vessels is None else args.vessels
    if names:
        print(f"{args.envs} of each vessel, {args.duration:g} s without a command:")
    for name in names:
        print(fate_line(Path(name).stem, fate(name, sea, args.envs, args.duration, args.seed, not args.quiet)))


if __name__ == "__main__":
    sys.exit(main())
