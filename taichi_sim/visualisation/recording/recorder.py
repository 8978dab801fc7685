"""Records a world's motion frame by frame: one environment, all teams, and what the models report."""

from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, TypedDict, Unpack

import numpy as np
import torch
from numpy.typing import NDArray

from taichi_sim.config.io import toml_text
from taichi_sim.fleet import Fleet
from taichi_sim.kernels.conventions import EAST, FREEBOARD, NO_DECK, NORTH
from taichi_sim.surroundings.sea import Sea
from taichi_sim.vehicle import Vehicle
from taichi_sim.visualisation.recording.episode import (
    Airframe,
    Array,
    Body,
    Episode,
    Event,
    Force,
    Platform,
    Scene,
    Signal,
    TeamTrack,
)
from taichi_sim.visualisation.recording.overlays import Overlay
from taichi_sim.world import World


class EpisodeParts(TypedDict, total=False):
    """Arguments of `Recorder.episode`."""

    name: str | None
    mission: Mapping[str, Mapping[str, Any]] | None
    scene: Scene | None
    events: Iterable[Event]
    overlays: Iterable[Overlay]
    config_text: str | None
    conditions: Mapping[str, Any]
    like: Episode | None


class Recorder:
    """Records environment `env` of a world, one frame for each `add`, and makes an `Episode` of the frames.

        recorder = Recorder(world)
        for _ in range(600):
            recorder.add(world.step(actions))
        recorder.write("world.rrd")

    Its clock starts at the world's time when it is made.
    """

    def __init__(self, world: World, env: int = 0, after: float = 0.0) -> None:
        """Begin a recording whose clock shows `after` (s) now."""
        if not 0 <= env < world.num_envs:
            raise ValueError(f"environment {env}: there are {world.num_envs}")
        self.world, self.env = world, env
        self._begin, self._sea = float(world.time[env]) - after, int(world.env_sea[env])
        self._time: list[float] = []
        self._last = -np.inf  # s, of the newest frame
        self._flows: list[tuple[Array, Array]] = []
        self._rows: dict[str, list[dict[str, Array]]] = {name: [] for name in world.teams}

    def __len__(self) -> int:
        """Number of frames."""
        return len(self._time)

    def add(self, actions: Mapping[str, torch.Tensor] | None = None) -> None:
        """Add a frame: the world now, and the `actions` (team -> [env, vehicle, action]) that led to it.

        Raises:
            ValueError: if the world's clock does not advance or its sea is another: a new episode has begun, which
                needs a recorder of its own.
        """
        now = self.now
        if int(self.world.env_sea[self.env]) != self._sea or now <= self._last:
            raise ValueError(f"environment {self.env} is not where it was recorded last: it was begun anew")
        self._time.append(now)
        self._last = now
        around = self.world.around
        self._flows.append((_copy(around.current[self.env]), _copy(around.wind[self.env])))
        for name, team in self.world.teams.items():
            self._rows[name].append(self._row(team, None if actions is None else actions.get(name)))

    def _row(self, team: Fleet[Vehicle], action: torch.Tensor | None) -> dict[str, Array]:
        env = torch.tensor([self.env], device=team.state.device)
        place = team.position_n[env]
        values = {
            "position_n": team.position_exact[self.env],
            "quaternion_nb": team.quaternion_nb[self.env],
            "velocity_n": team.velocity_n[self.env],
            "angular_velocity_b": team.angular_velocity_b[self.env],
            "wave_height": self.world.elevation(env, place[..., NORTH], place[..., EAST])[0],
            "aux": team.aux[self.env, :, : len(team.model.aux_names)],
            "freeboard": team.surface[self.env, :, FREEBOARD],
        }
        if action is not None:
            values["action"] = action[self.env]
        return {key: _copy(value) for key, value in values.items()}

    @property
    def now(self) -> float:
        """Time of the clock, s."""
        return float(self.world.time[self.env]) - self._begin

    @property
    def time_s(self) -> Array:
        """Times of the frames [T], s."""
        return np.array(self._time)

    def aux(self, team: str) -> Array:
        """Named columns of a team's auxiliary state [T, V, n]."""
        return np.stack([row["aux"] for row in self._rows[team]])

    def track(self, name: str, **mission: Any) -> TeamTrack:
        """TeamTrack of one team; `mission` gives its other fields: targets, slots, errors, rewards."""
        fleet, rows = self.world.teams[name], self._rows[name]
        model, lengths = fleet.model, fleet.vary.get("length") if fleet.varied else None
        keys = ("position_n", "quaternion_nb", "velocity_n", "angular_velocity_b", "wave_height")
        aux, freeboard = self.aux(name), np.stack([row["freeboard"] for row in rows])
        signals, surface = signals_of(model, aux), model.body()
        action_names, action = _actions(model.action_names, [row.get("action") for row in rows])
        if np.any(freeboard < NO_DECK):
            signals["freeboard"] = Signal(("freeboard",), "m", freeboard[..., None])
        return TeamTrack(
            name=name,
            medium=model.medium,
            size_m=model.size,
            scale=None if lengths is None else _copy(lengths[self.env] / model.size[0]),
            body=None if surface is None else Body(*surface),
            airframe=None if model.airframe is None else Airframe(*model.airframe),
            deck=None if model.deck is None else Platform(model.deck.centre, model.deck.half),
            air_n=None if model.air is None else _columns(model, aux, model.air),
            forces=forces_of(model, aux),
            signals=signals,
            action=action,
            action_names=action_names,
            **{key: np.stack([row[key] for row in rows]) for key in keys},
            **mission,
        )

    def episode(
        self,
        name: str | None = None,
        *,
        mission: Mapping[str, Mapping[str, Any]] | None = None,
        scene: Scene | None = None,
        events: Iterable[Event] = (),
        overlays: Iterable[Overlay] = (),
        config_text: str | None = None,
        conditions: Mapping[str, Any] | None = None,
        like: Episode | None = None,
    ) -> Episode:
        """Episode of all frames. A mission passes its own parts, which a bare world lacks.

        Args:
            name: default: the scenario's.
            mission: team -> further fields of its TeamTrack, [T, ...].
            scene, events, overlays, conditions: see Episode.
            config_text: Markdown; default: the world's configuration.
            like: for a part of an episode, see Episode.

        Raises:
            ValueError: if there is no frame yet, or an argument does not fit the frames.
        """
        if not self._time:
            raise ValueError("nothing to record: no frame was added")
        config, sea, begin, index = self.world.config, self.world.sea, self._begin, self._sea
        name = config.name if name is None else name
        return Episode(
            name=name,
            time_s=self.time_s,
            teams={team: self.track(team, **(mission or {}).get(team, {})) for team in self.world.teams},
            elevation=partial(_elevation, sea, begin, index),
            scene=scene or Scene(),
            config_text=f"# {name}\n\n```toml\n{toml_text(config)}```\n" if config_text is None else config_text,
            events=tuple(events),
            overlays=tuple(overlays),
            conditions=conditions or {},
            current_n=np.stack([current for current, _ in self._flows]),
            wind_n=np.stack([wind for _, wind in self._flows]),
            waves=partial(_waves, sea, begin, index),
            like=like,
        )

    def part(self, keep: int = 0, **parts: Unpack[EpisodeParts]) -> Episode:
        """Episode of the frames since the last part, which are then dropped, but for the last `keep`. `parts` are
        arguments of `episode`.
        """
        part, first = self.episode(**parts), len(self) - keep
        self._time, self._flows = self._time[first:], self._flows[first:]
        self._rows = {name: rows[first:] for name, rows in self._rows.items()}
        return part

    def write(self, path: str | Path, **parts: Unpack[EpisodeParts]) -> Path:
        """Write `episode(**parts)` to an .rrd file; see write_recording."""
        from taichi_sim.visualisation.recording.rrd import write_recording  # rerun takes a third of a second

        return write_recording(self.episode(**parts), Path(path))


def _elevation(sea: Sea, begin: float, index: int, north: NDArray, east: NDArray, time_s: float) -> NDArray:
    """Elevation of realisation `index` on a clock that began at `begin` (s); it advances waves once per time."""
    place = np.stack(np.broadcast_arrays(north, east), axis=-1)
    points = torch.from_numpy(place.reshape(-1, 2)).to(sea.table)
    env_sea = torch.tensor([index], dtype=torch.int32, device=points.device)
    phase = sea.phases(env_sea, torch.tensor([begin + time_s], dtype=torch.float64, device=points.device))
    rows = env_sea.new_zeros(len(points))
    return sea.elevation_at(points, rows, env_sea, phase).cpu().numpy().reshape(place.shape[:-1])


def _waves(sea: Sea, begin: float, index: int, time_s: float) -> Array:
    return sea.waves_at(begin + time_s, index)


def _copy(tensor: torch.Tensor) -> Array:
    return tensor.detach().cpu().numpy().copy()


def _actions(names: tuple[str, ...], rows: list[Array | None]) -> tuple[tuple[str, ...], Array | None]:
    """Names and values [T, V, A] of the actions of a TeamTrack: NaN in frames without; nothing if there are none."""
    known = next((row for row in rows if row is not None), None)
    if known is None:
        return (), None
    blank = np.full_like(known, np.nan)
    return names, np.stack([blank if row is None else row for row in rows])


def forces_of(model: Vehicle, aux: Array) -> dict[str, Force]:
    """Forces (N) from the named columns `aux` [T, V, n]."""
    return {name: Force(origin, _columns(model, aux, columns)) for name, (origin, columns) in model.forces.items()}


def signals_of(model: Vehicle, aux: Array) -> dict[str, Signal]:
    """Plots from the named columns `aux` [T, V, n]."""
    return {name: Signal(names, unit, _columns(model, aux, names)) for name, (unit, names) in model.signals.items()}


def _columns(model: Vehicle, aux: Array, names: Sequence[str | None]) -> Array:
    """The columns `names` [T, V, name] of `aux`; zeros for None."""
    if missing := [name for name in names if name is not None and name not in model.aux_names]:
        raise ValueError(f"{type(model).__name__}: no column {missing[0]!r} in aux_names {model.aux_names}")
    zeros = np.zeros(aux.shape[:-1], aux.dtype)
    return np.stack([zeros if name is None else aux[..., model.aux_names.index(name)] for name in names], axis=-1)
