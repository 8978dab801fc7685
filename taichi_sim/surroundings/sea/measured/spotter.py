"""Spectra of Sofar's Spotter: JSON of the API ("frequencyData"), and CSV of the dashboard (f_0, df_0, a1_0, ...).

| in the file | taken |
|---|---|
| timestamp, Epoch Time | time of the spectrum, UTC (not that of the parameters under "waves") |
| frequency, f | middles of the bands, Hz |
| df | their widths, Hz; they are not even: the last band is 30 times as wide as the first |
| varianceDensity | m^2/Hz |
| a1, b1, a2, b2 | moments of the direction of travel, counter-clockwise from east |
| direction | where waves come from, deg, clockwise from north: compared with a1 and b1, or used in their place |
| directionalSpread | sqrt(2 (1 - r1)), deg: used where there are no a1 and b1 |
"""

import json
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from taichi_sim.config import ConfigError
from taichi_sim.config.columns import LATEST, Sheet
from taichi_sim.errors import refuse
from taichi_sim.surroundings.sea.measured.spectra import Gridded, agreed, within_a_turn

NARROWEST = 2.0  # deg, the widest spread of a record, at least; less is a number of radians
NEEDED = ("f", "varianceDensity")
GIVEN = ("df", "a1", "b1", "a2", "b2", "direction", "directionalSpread")
OF_JSON = {"f": "frequency"}  # names in JSON where they differ from the CSV's


def is_spotter(begin: str) -> bool:
    """Whether a text that begins like this is of a Spotter."""
    return '"frequencyData"' in begin or '"spotterId"' in begin or ("Epoch Time" in begin and "f_0" in begin)


def read_spotter(path: Path) -> Gridded:
    """Read the spectra of a file."""
    text = path.read_text(encoding="utf-8-sig", errors="replace")
    times, columns = _of_json(text) if text.lstrip().startswith(("{", "[")) else _of_csv(path)
    for name in ("f", "df"):
        odd = (columns[name] != columns[name][0]).any(axis=1) if name in columns else np.zeros(1, dtype=bool)
        if odd.any():
            k = int(odd.argmax()) + 1
            raise ConfigError(f"{name} (frequencies and their widths) of record {k} differs from that of the first: "
                              "make a file for each")  # fmt: skip
    bands, frequency = None, columns["f"][0]
    if "df" in columns:
        width = columns["df"][0]
        bands = np.stack((frequency - width / 2, frequency + width / 2), axis=1)
    density, (c1, c2) = columns["varianceDensity"], _moments(columns)
    c1, c2 = (None if c is None else c[:, None] for c in (c1, c2))
    return Gridded(times, [path.stem], frequency, density[:, None], c1=c1, c2=c2, bands=bands)


def _moments(columns: dict[str, np.ndarray]) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Moments of the direction of travel, clockwise from north: exp(i (pi/2 - x)) of those from east."""
    stated = None
    if "direction" in columns:
        within_a_turn("direction", columns["direction"])
        stated = columns["direction"] + 180.0
    if "a1" in columns and "b1" in columns:
        c1 = 1j * (columns["a1"] - 1j * columns["b1"])
        if stated is not None:
            agreed(c1, stated, columns["varianceDensity"])
        second = "a2" in columns and "b2" in columns
        return c1, -(columns["a2"] - 1j * columns["b2"]) if second else np.full(c1.shape, np.nan + 0j)
    if stated is None or "directionalSpread" not in columns:
        return None, None
    if 0 < np.nan_to_num(columns["directionalSpread"]).max() < NARROWEST:
        raise ConfigError("directionalSpread is below 2 everywhere: directions and spreads must be in degrees")
    r1 = np.clip(1 - np.deg2rad(columns["directionalSpread"]) ** 2 / 2, 0.0, 1.0)
    c1 = r1 * np.exp(1j * np.deg2rad(stated))
    return c1, np.full(c1.shape, np.nan + 0j)


def _of_json(text: str) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Times and columns [t, f] of the API's JSON."""
    try:
        answers = json.loads(text)
        answer, *others = answers if isinstance(answers, list) else [answers]
        rows = answer["data"]["frequencyData"]
        stamps = [_moment(row["timestamp"]) for row in rows]
        keys = {name: OF_JSON.get(name, name) for name in (*NEEDED, *GIVEN)}
        found = {
            name: np.array([row[key] for row in rows], dtype=float)
            for name, key in keys.items() if name in NEEDED or all(row.get(key) for row in rows)
        }  # fmt: skip
    except (ValueError, TypeError, AttributeError, KeyError, RecursionError) as error:
        told = f"no {error} in it" if isinstance(error, KeyError) else f"{error}: is it cut short?"
        raise ConfigError(f"no spectra of a Spotter (frequencyData with frequency, varianceDensity): {told}") from None
    odd = next(
        (keys[name] for name, column in found.items() if column.ndim != 2 or column.shape != found["f"].shape), ""
    )
    refuse(
        ConfigError,
        (others, f"it holds {1 + len(others)} answers of the API: write a file of each"),
        (not stamps, "it has no spectrum under frequencyData: ask the API for it by includeFrequencyData=true"),
        (odd, f"{odd} and frequency differ in their lengths: is it cut short?"),
    )
    return np.array(stamps, dtype="datetime64[m]"), found


def _moment(text: str) -> datetime:
    moment = datetime.fromisoformat(text)
    return moment.astimezone(UTC).replace(tzinfo=None) if moment.tzinfo else moment


def _of_csv(path: Path) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Times and columns [t, f] of the dashboard's CSV."""
    sheet = Sheet(path)
    clock = sheet.find("Epoch Time")
    if clock is None or not sheet.rows:
        raise ConfigError("no column Epoch Time, or no row under it")
    seconds = sheet.numbers(clock)
    sheet.judge((~((seconds > 0) & (seconds < LATEST)), lambda k: f"Epoch Time = {seconds[k]:g}: not in s"))
    found = {}
    for name in (*NEEDED, *GIVEN):
        places = []
        while (place := sheet.find(f"{name}_{len(places)}")) is not None:
            places.append(place)
        if not places and name in GIVEN:
            continue
        found[name] = (
            np.stack([sheet.numbers(place, missing=True) for place in places], axis=1) if places else np.empty(0)
        )
        if found[name].shape != found["f"].shape or not places:
            raise ConfigError(f"{len(places)} columns {name}_0, {name}_1, ... beside {found['f'].shape[-1]} of f")
    return seconds.astype("datetime64[s]").astype("datetime64[m]"), found
