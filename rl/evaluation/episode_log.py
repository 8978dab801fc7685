"""What a report shows of single episodes: motion, actions, and the seconds before each collision.

An `EpisodeLog` records a whole chunk of episodes, because the worst and the median are known only at the end; it skips
decisions where episodes are long. The excerpts that a report shows are stored beside the figures (store.py).
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from rl.judge import Judge
from rl.mission import Mission, Step
from taichi_sim.config.io import replacing

Array = NDArray[np.floating]
BUDGET = 2.5e8  # most bytes of a log
BEFORE = 5.0  # s shown before a collision
MAX_CRASHES = 12  # collisions in a report

EVENTS = {
    "collided": ("collision", "hit an obstacle or a team mate"),
    "lost": ("lost", "is too far from its slot"),
    "crashed": ("crashed", "has touched the water"),
    "stalled": ("stalled", "has not recovered from a stall"),
    "ditched": ("ditched", "has met the water, with its feet or a rotor"),
    "struck": ("struck", "has met a deck with a rotor"),
    "landed": ("landed", "has landed"),
    "hard": ("hard", "has come down too hard"),
    "toppled": ("toppled", "has toppled on the deck"),
    "slid": ("slid", "has slid on the deck"),
    "late": ("late", "has not landed in time"),
    "capsized": ("capsized", "has turned over"),
    "swamped": ("swamped", "has water on deck"),
    "grounded": ("grounded", "has touched the ground"),
    "left": ("left", "has left the area"),
    "diverged": ("diverged", "has no finite state any more"),
}
"""Name of an ending -> kind of event and its text, which follows the vehicle's name."""


def event_of(field: str) -> tuple[str, str]:
    """The kind and the text of an ending; an ending that is not in `EVENTS` gets a text made of its name."""
    return EVENTS.get(field, (field, f"has ended: {field.replace('_', ' ')}"))


class TeamLog(NamedTuple):
    """One team at T moments, with V vehicles and A actions."""

    medium: str
    position_n: Array  # [T, V, 3] m
    action: Array  # [T, V, A]
    action_names: tuple[str, ...]
    series: dict[str, Array]  # label with unit -> [T, V]


class Ended(NamedTuple):
    """The end of one vehicle."""

    time_s: float
    team: str
    vehicle: int
    text: str  # the reason


class Excerpt(NamedTuple):
    """An episode, or a part of it."""

    episode: int  # number in its evaluation
    time_s: Array  # [T] s since it began
    teams: dict[str, TeamLog]
    events: tuple[Ended, ...]  # in order of time
    obstacles: Array  # [M, 4] north, east, radius, height (up), m
    tracks_n: dict[str, Array]  # team -> [P, 3] m


class End(NamedTuple):
    """The end of one vehicle of an episode, by the name of the ending."""

    episode: int
    time_s: float
    team: str
    vehicle: int
    ending: str


class Crash(NamedTuple):
    """A collision of one team: the vehicles that collided at one moment, and the seconds before."""

    team: str
    vehicles: tuple[int, ...]
    time_s: float
    before: Excerpt  # of this team


class EpisodeLog:
    """Records every environment of a mission; environment 0 is episode `first`."""

    def __init__(self, mission: Mission, first: int = 0):
        """Record a mission at the start of its episodes."""
        self.mission, self.first = mission, first
        numbers = sum(
            t.fleet.state.shape[0] * t.fleet.count * (6 + len(t.fleet.model.action_names))
            for t in mission.teams.values()
        )
        self.stride = max(1, int(np.ceil(4 * numbers * mission.config.episode_steps / BUDGET)))
        self._time: list[float] = []
        self._rows: dict[str, list[dict[str, Array]]] = {name: [] for name in mission.teams}
        self._ends: dict[int, list[tuple[float, str, str, int]]] = {}  # environment -> time, team, ending, vehicle

    def see(self, judges: Mapping[str, Judge], step: Step, number: int) -> None:
        """Record decision `number` (from 1); call this before the judges see the decision."""
        time = number * self.mission.config.decision_interval
        for name, judge in judges.items():
            for kind, flags in step.endings[name].items():
                for env, vehicle in np.argwhere(flags.cpu().numpy() & ~judge.failed[:, None]).tolist():
                    self._ends.setdefault(env, []).append((time, name, kind, vehicle))
        if number % self.stride:
            return
        self._time.append(time)
        for name, judge in judges.items():
            team = self.mission.teams[name]
            series = {label: _to_array(value) for label, value in judge.series().items()}
            self._rows[name].append(
                {"place": _to_array(team.fleet.position_n), "action": _to_array(team.action)} | series
            )

    def excerpt(self, env: int) -> Excerpt:
        """The whole episode of an environment."""
        return self._excerpt(env, np.ones(len(self._time), dtype=bool), tuple(self._rows))

    def ends(self) -> list[End]:
        """The ends of vehicles that count for the judges, by episode and time: none after the first of a team."""
        ordered = ((env, *end) for env, of in sorted(self._ends.items()) for end in sorted(of))
        return [End(self.first + env, round(time, 6), team, v, kind) for env, time, team, kind, v in ordered]

    def crashes(self) -> list[Crash]:
        """The first `MAX_CRASHES` collisions that count for the judges, by episode and time."""
        found: list[Crash] = []
        for env, ends in sorted(self._ends.items()):
            moments = sorted({(time, team) for time, team, kind, _ in ends if kind == "collided"})
            for time, team in moments[: max(0, MAX_CRASHES - len(found))]:
                who = tuple(v for t, name, kind, v in ends if (t, name, kind) == (time, team, "collided"))
                times = np.array(self._time)
                before = self._excerpt(env, (times > time - BEFORE) & (times <= time), (team,))
                found.append(Crash(team, who, time, before))
        return found

    def _excerpt(self, env: int, when: NDArray[np.bool_], teams: tuple[str, ...]) -> Excerpt:
        scene = self.mission.scene(env)
        ends = [Ended(time, team, vehicle, event_of(kind)[1]) for time, team, kind, vehicle in self._ends.get(env, [])]
        return Excerpt(
            episode=self.first + env,
            time_s=np.array(self._time)[when],
            teams={name: self._team(name, env, when) for name in teams},
            events=tuple(sorted(ends)),
            obstacles=np.zeros((0, 4)) if scene is None else np.asarray(scene.obstacles),
            tracks_n={} if scene is None else {name: np.asarray(track) for name, track in scene.tracks_n.items()},
        )

    def _team(self, name: str, env: int, when: NDArray[np.bool_]) -> TeamLog:
        model = self.mission.teams[name].fleet.model
        rows = [row for row, wanted in zip(self._rows[name], when, strict=True) if wanted]
        values = {key: np.stack([row[key][env] for row in rows]) for key in self._rows[name][0]} if rows else {}
        place, action = values.pop("place", np.zeros((0, 1, 3))), values.pop("action", np.zeros((0, 1, 0)))
        return TeamLog(model.medium, place, action, tuple(model.action_names), values)


def _to_array(value: Tensor) -> Array:
    """Copy a tensor to a float32 array."""
    return value.detach().float().cpu().numpy().copy()


def save_log(file: Path, shown: Mapping[str, Excerpt], crashes: list[Crash]) -> None:
    """Write the excerpts and collisions that a report shows into one .npz file."""
    arrays: dict[str, Array] = {}
    fields = {name: _packed(shown[name], name, arrays) for name in sorted(shown)}  # the same order on any rank
    crashed = [
        {"team": c.team, "vehicles": c.vehicles, "time": c.time_s, "before": _packed(c.before, f"crash{i}", arrays)}
        for i, c in enumerate(crashes)
    ]
    with replacing(file) as part:
        np.savez_compressed(part, about=np.array(json.dumps({"shown": fields, "crashes": crashed})), **arrays)  # pyright: ignore[reportArgumentType]


def load_log(file: Path) -> tuple[dict[str, Excerpt], list[Crash]]:
    """Read the file that `save_log` wrote; without a file, both results are empty."""
    if not file.is_file():
        return {}, []
    with np.load(file) as content:
        arrays = dict(content)
    about = json.loads(str(arrays.pop("about")))
    shown = {name: _unpacked(fields, name, arrays) for name, fields in about["shown"].items()}
    crashes = [
        Crash(c["team"], tuple(c["vehicles"]), c["time"], _unpacked(c["before"], f"crash{i}", arrays))
        for i, c in enumerate(about["crashes"])
    ]
    return shown, crashes


def _packed(excerpt: Excerpt, name: str, arrays: dict[str, Array]) -> dict[str, Any]:
    """Put the arrays of an excerpt into `arrays`, under keys that begin with `name`; return its other fields."""
    arrays |= {f"{name}/time": excerpt.time_s, f"{name}/obstacles": excerpt.obstacles}
    arrays |= {f"{name}/track/{team}": track for team, track in excerpt.tracks_n.items()}
    for team, of in excerpt.teams.items():
        arrays |= {f"{name}/{team}/place": of.position_n, f"{name}/{team}/action": of.action}
        arrays |= {f"{name}/{team}/series/{k}": values for k, values in enumerate(of.series.values())}
    teams = {
        t: {"medium": of.medium, "actions": of.action_names, "series": [*of.series]} for t, of in excerpt.teams.items()
    }
    return {"episode": excerpt.episode, "events": excerpt.events, "teams": teams, "tracks": [*excerpt.tracks_n]}


def _unpacked(fields: Mapping[str, Any], name: str, arrays: Mapping[str, Array]) -> Excerpt:
    teams = {
        team: TeamLog(
            of["medium"],
            arrays[f"{name}/{team}/place"],
            arrays[f"{name}/{team}/action"],
            tuple(of["actions"]),
            {label: arrays[f"{name}/{team}/series/{k}"] for k, label in enumerate(of["series"])},
        )
        for team, of in fields["teams"].items()
    }
    return Excerpt(
        fields["episode"],
        arrays[f"{name}/time"],
        teams,
        tuple(Ended(*event) for event in fields["events"]),
        arrays[f"{name}/obstacles"],
        {team: arrays[f"{name}/track/{team}"] for team in fields["tracks"]},
    )
