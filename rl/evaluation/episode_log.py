"""What a report shows of single episodes: how vehicles moved and acted, and what came before a collision.

A `Log` watches a whole chunk of episodes, thinned where they are long, because which of them is the worst or the median
is known only at the end. What is shown of it is kept as arrays beside the figures (store.py).
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rl.evaluation.events import event_of
from rl.mission import Step

Array = NDArray[Any]
BUDGET = 2.5e8  # bytes that a log may take
BEFORE = 5.0  # s before a collision that are shown of it
MOST = 12  # collisions that are shown


class TeamLog(NamedTuple):
    """One team over T moments; V vehicles, A actions."""

    medium: str
    place_n: Array  # [T, V, 3] m
    action: Array  # [T, V, A]
    action_names: tuple[str, ...]
    series: dict[str, Array]  # label with unit -> [T, V]


class Ended(NamedTuple):
    """A vehicle whose end was its team's."""

    time_s: float
    team: str
    vehicle: int
    text: str  # what happened to it


class Excerpt(NamedTuple):
    """An episode, or a part of it."""

    episode: int  # number in its evaluation
    time_s: Array  # [T] s since it began
    teams: dict[str, TeamLog]
    events: tuple[Ended, ...]  # in order of time
    obstacles: Array  # [M, 4] north, east, radius, height (up), m
    tracks_n: dict[str, Array]  # team -> [P, 3] m


class Crash(NamedTuple):
    """Vehicles of one team that collided at one moment, and the time before."""

    team: str
    vehicles: tuple[int, ...]
    time_s: float
    before: Excerpt  # of that team alone


class Log:
    """Watches every environment of a mission; environment 0 is episode `first`."""

    def __init__(self, mission: Any, first: int = 0):
        """Watch a mission whose episodes are about to begin."""
        self.mission, self.first = mission, first
        numbers = sum(
            t.fleet.state.shape[0] * t.fleet.count * (6 + len(t.fleet.model.action_names))
            for t in mission.teams.values()
        )
        self.stride = max(1, int(np.ceil(4 * numbers * mission.config.episode_steps / BUDGET)))
        self._time: list[float] = []
        self._rows: dict[str, list[dict[str, Array]]] = {name: [] for name in mission.teams}
        self._ends: dict[int, list[tuple[float, str, str, int]]] = {}  # environment -> time, team, ending, vehicle

    def see(self, judges: Mapping[str, Any], step: Step, number: int) -> None:
        """Keep decision `number` (from 1), before the judges have seen it."""
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
            series = {label: _kept(value) for label, value in judge.series().items()}
            self._rows[name].append({"place": _kept(team.fleet.position_n), "action": _kept(team.action)} | series)

    def excerpt(self, env: int) -> Excerpt:
        """The episode of an environment."""
        return self._excerpt(env, np.ones(len(self._time), dtype=bool), tuple(self._rows))

    def crashes(self) -> list[Crash]:
        """The first `MOST` collisions that the judges counted, by episode and time."""
        found: list[Crash] = []
        for env, ends in sorted(self._ends.items()):
            moments = sorted({(time, team) for time, team, kind, _ in ends if kind == "collided"})
            for time, team in moments[: max(0, MOST - len(found))]:
                who = tuple(v for t, name, kind, v in ends if (t, name, kind) == (time, team, "collided"))
                times = np.array(self._time)
                before = self._excerpt(env, (times > time - BEFORE) & (times <= time), (team,))
                found.append(Crash(team, who, time, before))
        return found

    def _excerpt(self, env: int, when: Array, teams: tuple[str, ...]) -> Excerpt:
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

    def _team(self, name: str, env: int, when: Array) -> TeamLog:
        model = self.mission.teams[name].fleet.model
        rows = [row for row, wanted in zip(self._rows[name], when, strict=True) if wanted]
        values = {key: np.stack([row[key][env] for row in rows]) for key in self._rows[name][0]} if rows else {}
        place, action = values.pop("place", np.zeros((0, 1, 3))), values.pop("action", np.zeros((0, 1, 0)))
        return TeamLog(model.medium, place, action, tuple(model.action_names), values)


def _kept(value: Any) -> Array:
    """A copy, small."""
    return value.detach().float().cpu().numpy().copy()


def save_log(file: Path, shown: Mapping[str, Excerpt], crashes: list[Crash]) -> None:
    """Write what a report shows into one .npz file."""
    arrays: dict[str, Array] = {}
    told = {name: _packed(shown[name], name, arrays) for name in sorted(shown)}  # whoever found them first
    crashed = [
        {"team": c.team, "vehicles": c.vehicles, "time": c.time_s, "before": _packed(c.before, f"crash{i}", arrays)}
        for i, c in enumerate(crashes)
    ]
    part = file.with_name(file.name + ".part.npz")
    np.savez_compressed(part, about=np.array(json.dumps({"shown": told, "crashes": crashed})), **arrays)  # pyright: ignore[reportArgumentType]
    part.replace(file)


def load_log(file: Path) -> tuple[dict[str, Excerpt], list[Crash]]:
    """What `save_log` has written; nothing where there is no such file."""
    if not file.is_file():
        return {}, []
    with np.load(file) as content:
        arrays = dict(content)
    about = json.loads(str(arrays.pop("about")))
    shown = {name: _unpacked(told, name, arrays) for name, told in about["shown"].items()}
    crashes = [
        Crash(c["team"], tuple(c["vehicles"]), c["time"], _unpacked(c["before"], f"crash{i}", arrays))
        for i, c in enumerate(about["crashes"])
    ]
    return shown, crashes


def _packed(excerpt: Excerpt, name: str, arrays: dict[str, Array]) -> dict[str, Any]:
    """Put the arrays of an excerpt into `arrays`, under `name`; what else there is of it."""
    arrays |= {f"{name}/time": excerpt.time_s, f"{name}/obstacles": excerpt.obstacles}
    arrays |= {f"{name}/track/{team}": track for team, track in excerpt.tracks_n.items()}
    for team, of in excerpt.teams.items():
        arrays |= {f"{name}/{team}/place": of.place_n, f"{name}/{team}/action": of.action}
        arrays |= {f"{name}/{team}/series/{k}": values for k, values in enumerate(of.series.values())}
    teams = {
        t: {"medium": of.medium, "actions": of.action_names, "series": [*of.series]} for t, of in excerpt.teams.items()
    }
    return {"episode": excerpt.episode, "events": excerpt.events, "teams": teams, "tracks": [*excerpt.tracks_n]}


def _unpacked(told: Mapping[str, Any], name: str, arrays: Mapping[str, Array]) -> Excerpt:
    teams = {
        team: TeamLog(
            of["medium"],
            arrays[f"{name}/{team}/place"],
            arrays[f"{name}/{team}/action"],
            tuple(of["actions"]),
            {label: arrays[f"{name}/{team}/series/{k}"] for k, label in enumerate(of["series"])},
        )
        for team, of in told["teams"].items()
    }
    return Excerpt(
        told["episode"],
        arrays[f"{name}/time"],
        teams,
        tuple(Ended(*event) for event in told["events"]),
        arrays[f"{name}/obstacles"],
        {team: arrays[f"{name}/track/{team}"] for team in told["tracks"]},
    )
