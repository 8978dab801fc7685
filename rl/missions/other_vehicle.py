"""What of a scenario holds for another vehicle than its file names: `--set usv.vehicle=cat.toml`.

| key | for the other vehicle |
|---|---|
| `TEAM.vary`: `factor` | stays, if the vehicle has the number and it is not 0 |
| `TEAM.vary`: `range`, `add` | stays if both have the same number, or else scales with it; positions by length |
| `TEAM.vary` of propellers | goes to the vehicle's thrusters of another kind: gain to gain, lag to lag |
| `TEAM.control` | stays if the controller is of the same class; its lengths are scaled by length |
| `TEAM.spacing`, `lost_distance` | scaled by length; `start_distance` by that of a shorter vehicle |
| `obstacles` beside the lanes | move with the edge of the team's formation |
| `TEAM.target_speed`, also `track`'s; `residual.velocity` | scaled by speed, of one that is slower or cannot stop |
| `stages.NAME.set.dt` | stays, if the vehicle's own step is no shorter than the old one's |

Length is that of the vehicle, speed its cruise, or where it has none its top speed. A ratio within ALIKE of 1 counts as
1. Keys that the overrides set are theirs. `Scenario.replaced` lists everything that is not kept or was scaled.

Of 48 episodes of `cruise` with the WAM-V, the classical controller holds formation in 42 with the gains of an Otter, in
26 with its class's own.
"""

import contextlib
import copy
from collections.abc import Container, Iterable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import ValidationError

from rl.guidance.controllers import controller_class, controller_of
from rl.guidance.shapes import lane_half_width
from rl.missions.formation.config import FormationTeam
from rl.scenario import Scenario
from rl.team import ControllerError
from taichi_sim.config import ConfigError, Range, TeamConfig
from taichi_sim.config.base import Table
from taichi_sim.config.io import (
    apply_overrides,
    key_of,
    parse_value,
    read_toml,
    validate,
    vehicle_file,
    with_tuples,
)
from taichi_sim.config.vary import flattened
from taichi_sim.models.catalogue import describe, find_model, step_of
from taichi_sim.vehicle import Vehicle

ALIKE = 0.1  # lengths and speeds that differ by less are the same; assumed
MOST = 10.0  # largest ratio, and the inverse of the smallest: beyond it the scenario's tracks do not fit; assumed
DIGITS = 3  # of scaled numbers
POSITIONS = ("rigid_body.cg",)  # keys of positions, which a value of the vehicle does not scale
SCALED = {  # key of a team -> what scales it
    "spacing": "length", "formation.spacing_range": "length", "start_distance": "shorter", "lost_distance": "length",
    "target_speed": "speed", "formation.glide": "speed", "residual.velocity": "speed",
}  # fmt: skip

WIDTH = ("vehicle", "count", "formation", "spacing")  # keys that the width of a formation depends on


class Swap(NamedTuple):
    """One vehicle in place of another: their models, names and physics steps (s)."""

    old: Vehicle
    new: Vehicle
    names: tuple[str, str]
    steps: tuple[float, float]

    @property
    def length(self) -> float:
        """Ratio of the lengths."""
        return _ratio(self.old.size[0], self.new.size[0])

    @property
    def shorter(self) -> float:
        """That of a shorter vehicle; 1 for a longer one."""
        return min(self.length, 1.0)

    @property
    def speed(self) -> float:
        """Ratio of the speeds; 1 where one is not known, or a faster vehicle can go as slowly as it likes."""
        ratio = _ratio(*(_speed(model) for model in (self.old, self.new)))
        return min(ratio, 1.0) if self.new.limits.stops else ratio


def _speed(model: Vehicle) -> float:
    _, cruise, top = model.limits.speeds
    return cruise or top


def _ratio(old: float, new: float) -> float:
    if not 0 < old * new < float("inf") or abs(new / old - 1) < ALIKE:
        return 1.0
    return min(max(new / old, 1 / MOST), MOST)


def fit_other_vehicles(data: Table, overrides: Iterable[str], file: Path, kind: type[Scenario]) -> None:
    """Fit the teams of a scenario's `data` of type `kind`, read from `file`, to the vehicles that the `overrides` name.

    What changes is listed in the data's `replaced`.
    """
    overrides = list(overrides)
    given = {key_of(text): text.partition("=")[2] for text in overrides}
    if not any(key.endswith(".vehicle") for key in given):
        return
    wanted, told = copy.deepcopy(data), []
    apply_overrides(wanted, overrides, kind)
    teams: Any = {name: each for name, each in wanted.items() if isinstance(each, dict) and "vehicle" in each}
    for team, section in data.items():
        name = parse_value(given.get(f"{team}.vehicle", "").strip())
        if isinstance(section, dict) and isinstance(name, str) and name and isinstance(section.get("vehicle"), str):
            with contextlib.suppress(ConfigError):  # told where the vehicle is loaded
                files = [vehicle_file(TeamConfig(vehicle=each), file) for each in (section["vehicle"], name)]
                if files[0].resolve() != files[1].resolve():
                    told += _fit(data, team, files, file, given, teams)
    if told:
        before = data.get("replaced", ())
        data["replaced"] = [*(before if isinstance(before, list) else ()), *told]


@lru_cache(maxsize=16)
def _described(file: Path, source: Path, written: float) -> Vehicle:
    return describe(file, source)


def _fit(
    data: Table, team: str, files: list[Path], source: Path, given: Container[str], teams: Mapping[str, Table]
) -> list[str]:
    """Fit one team; return what changed, in lines. `teams`: the sections with the overrides."""
    media = [find_model(read_toml(file).get("model"), file, source).medium for file in files]
    section: dict[str, Any] = data[team]  # pyright: ignore[reportAssignmentType]
    if media[0] != media[1]:
        dropped = [key for key in ("vary", "control") if section.pop(key, None)]
        return [f"{team}.{key}: dropped, for it was of {files[0].stem}, in the {media[0]}" for key in dropped]
    old, new = (_described(file, source, file.stat().st_mtime) for file in files)
    swap = Swap(old, new, (files[0].stem, files[1].stem), (step_of(files[0]), step_of(files[1])))
    lines = [f"{team}: {swap.names[1]} in place of {swap.names[0]}: length {old.size[0]:.3g} -> {new.size[0]:.3g} m, "
             f"speed {_speed(old):.3g} -> {_speed(new):.3g} m/s"]  # fmt: skip
    if f"{team}.vary" not in given:
        section["vary"], told = _ranges(flattened(section.get("vary", {})), swap)
        lines += [f"{team}.vary: {', '.join(keys)}: {why}" for why, keys in told.items()]
    lines += _numbers(data, team, swap, given) + _obstacles(data, team, teams, swap, given)
    lines += _gains(section, team, swap, given) + _steps(data, team, swap)
    return lines + (_controller(team, new) if controller_class(old) else [])


# -- ranges ------------------------------------------------------------------------------------------------------------


def _ranges(ranges: Any, swap: Swap) -> tuple[Table, dict[str, list[str]]]:
    """`[TEAM.vary]` for the new vehicle, and its changes: what happened -> keys."""
    kept: Table = {}
    told: dict[str, list[str]] = {}
    for key, given in ranges.items() if isinstance(ranges, dict) else ():
        try:
            span = Range.model_validate(with_tuples(given))
        except ValidationError:
            kept[key] = given  # refused where it is read
            continue
        if key not in swap.old.varying or key in swap.new.varying:
            value, why = _range(key, key, span, swap)
            if value is not None:
                kept[key] = given if why is None else value
            if why is not None:
                told.setdefault(why, []).append(key)
            continue
        others = [other for other in swap.new.varying if _thruster(key) and _thruster(other) == _thruster(key)]
        fitted = {other: _range(key, other, span, swap)[0] for other in others}
        found = {other: value for other, value in fitted.items() if value is not None}
        kept = found | kept  # the first of several, as of left and right
        why = f"for {', '.join(found)} now" if found else f"dropped, no number of {swap.names[1]}"
        told.setdefault(why, []).append(key)
    return kept, told


def _thruster(key: str) -> str:
    """The number of a thruster that a key is of, whatever the thruster: "gain" or "lag"; empty for another key."""
    section, _, last = key.partition(".")
    return last.rpartition(".")[2].partition("_")[0] if section in ("thrusters", "actuators") else ""


def _range(key: str, other: str, span: Range, swap: Swap) -> tuple[Table | None, str | None]:
    """A range of `key` for the number `other` of the new vehicle, None if it means nothing; and what changed."""
    if key not in swap.old.varying:
        return span.model_dump(exclude_none=True), None  # refused where it is read
    before, after = swap.old.nominal[key], swap.new.nominal[other]
    whole = span.model_dump(mode="json", exclude_none=True)
    position = key.rpartition(".")[0] in POSITIONS and span.way == "add"
    if span.way == "factor" or (before == after and not position):
        useless = span.way == "factor" and after == 0
        return (None, f"dropped, 0 in {swap.names[1]}") if useless else (whole, None)
    if not position and not before * after > 0:
        return None, f"dropped, {before:.3g} in {swap.names[0]} and {after:.3g} in {swap.names[1]}"
    ratio = swap.length if position else after / before
    scaled = whole | {span.way: _times(whole[span.way], ratio)}
    how = "by length" if position else "in proportion"
    return scaled, None if ratio == 1 else f"{span.way} {whole[span.way]} -> {scaled[span.way]}, {how}"


# -- numbers of the team -----------------------------------------------------------------------------------------------


def _times(value: Any, factor: float) -> Any:
    if isinstance(value, list | tuple):
        return [_times(one, factor) for one in value]
    return float(f"{value * factor:.{DIGITS}g}")


def _numbers(data: Table, team: str, swap: Swap, given: Container[str]) -> list[str]:
    """Scale lengths and speeds of a team; what changed."""
    section: Any = data[team]
    track: Any = data.get("track", {})
    shared = "target_speed" in track and "target_speed" not in section
    if swap.speed != 1 and shared and "track.target_speed" not in given:
        section["target_speed"] = track["target_speed"]
    told = []
    for key, how in SCALED.items():
        *parents, last = key.split(".")
        node: Any = section
        for parent in parents:
            node = node.get(parent) if isinstance(node, dict) else None
        value, factor = node.get(last) if isinstance(node, dict) else None, getattr(swap, how)
        own = any(f"{team}.{part}" in given for part in (key, parents[0] if parents else key))
        if isinstance(value, int | float | list) and factor != 1 and not own:
            node[last] = _times(value, factor)
            told.append(f"{team}.{key}: {value} -> {node[last]}, by {'speed' if how == 'speed' else 'length'}")
    return told


def _obstacles(data: Table, team: str, teams: Mapping[str, Table], swap: Swap, given: Container[str]) -> list[str]:
    """Move obstacles with the edge of a team's formation; what changed. `teams`: the sections with the overrides.

    Their clearance counts from the widest formation of all teams.
    """
    obstacles: Any = data.get("obstacles")
    if swap.length == 1 or not isinstance(obstacles, dict) or "clearance_min" not in obstacles:
        return []
    try:
        old = {name: _half_width(section) for name, section in teams.items()}
        new = old | {team: old[team] * (1.0 if f"{team}.spacing" in given else swap.length)}
    except ConfigError:
        return []  # refused where it is read
    out, wider, told = new[team] - old[team], max(new.values()) - max(old.values()), []
    for key, move in (("clearance_min", out - wider), ("clearance_max", out - wider), ("track_clearance", out)):
        if isinstance(value := obstacles.get(key), int | float) and move and f"obstacles.{key}" not in given:
            obstacles[key] = round(max(value + move, 0.0) if key == "track_clearance" else value + move, DIGITS)
            told.append(f"obstacles.{key}: {value} -> {obstacles[key]}, with the edge of {team}'s formation")
    return told


def _half_width(section: Table) -> float:
    team = validate(FormationTeam, {key: section[key] for key in WIDTH if key in section}, "")
    return lane_half_width(team.shapes, team.count, team.spacings[1])


def _gains(section: dict[str, Any], team: str, swap: Swap, given: Container[str]) -> list[str]:
    """Scale the gains of a team's classical controller, or drop them; what changed."""
    gains = section.get("control")
    if not isinstance(gains, dict) or not gains or f"{team}.control" in given:
        return []
    old, kind = (None if model.controller else controller_class(model) for model in (swap.old, swap.new))
    if kind is None or old is not kind:
        del section["control"]
        return [f"{team}.control: dropped, for it was of the controller of {swap.names[0]}"]
    scaled = {
        key: _times(value, swap.length)
        for key in kind.Gains.lengths
        if isinstance(value := gains.get(key), int | float) and swap.length != 1
        and f"{team}.control.{key}" not in given
    }  # fmt: skip
    section["control"] = gains | scaled
    changes = "".join(f"{key} {gains[key]} -> {value}, by length; " for key, value in scaled.items())
    return [f"{team}.control: tuned for {swap.names[0]}; {changes}taichi-sim tune --team {team} tunes it anew"]


def _steps(data: Table, team: str, swap: Swap) -> list[str]:
    """Drop physics steps of the stages that the vehicle cannot take; what changed."""
    stages, told = data.get("stages", {}), []
    for name, stage in stages.items() if isinstance(stages, Mapping) else ():
        changes = stage.get("set") if isinstance(stage, dict) else None
        if not isinstance(changes, dict) or swap.steps[1] >= swap.steps[0]:
            continue
        for key in changes.keys() & {"dt", f"{team}.dt"}:
            del changes[key]
            told.append(f"stages.{name}.set.{key}: dropped, for {swap.names[1]} needs steps of {swap.steps[1]:g} s")
    return told


def _controller(team: str, model: Vehicle) -> list[str]:
    """Whether the vehicle has no classical controller, and the way to one."""
    if model.controller is not None:
        return []
    try:
        found = controller_of(model, {}, f"{team}.control")
    except ControllerError as error:
        return [f"{team}: no classical controller acts for it: {error}"]
    none = f"{team}: no classical controller acts for it: write one, `controller` of its model (docs/extending.md)"
    return [] if found is not None else [none]
