"""An episode to record; what is in a recording's file, and whether its layout shows anything that is not."""

from collections.abc import Iterator, Mapping, Sequence
from fnmatch import fnmatch
from pathlib import Path

import numpy as np
import rerun.blueprint as rrb
from numpy.typing import NDArray
from rerun.chunk import RrdReader

from taichi_sim.visualisation.recording import Episode, Event, Medium, Scene, TeamTrack
from taichi_sim.visualisation.recording.blueprint import blueprint

RADIUS_M, AMPLITUDE_M, WAVENUMBER = 80.0, 0.4, 0.3
ACTIONS = {"usv": ("thrust", "turn"), "uav": ("aileron", "elevator", "rudder", "throttle")}
SIZES = {"usv": (2.0, 1.08, 0.5), "uav": (1.7, 2.9, 0.55)}
MEDIA: dict[str, Medium] = {"usv": "water", "uav": "air"}
HEIGHTS = {"usv": 0.0, "uav": 40.0}


def elevation(north: NDArray, east: NDArray, time_s: float) -> NDArray:
    return AMPLITUDE_M * np.cos(WAVENUMBER * north - 1.7 * time_s) + 0.0 * east


def circling_team(name: str, vehicles: int, time: NDArray) -> TeamTrack:
    """Vehicles on one circle, one behind the other, rolled by 0.1 rad."""
    angle = 0.05 * time[:, None] - 0.1 * np.arange(vehicles)
    down = np.full_like(angle, -HEIGHTS[name])
    slot = np.stack([RADIUS_M * np.cos(angle), RADIUS_M * np.sin(angle), down], axis=-1)
    position = slot + (0.5, -0.25, 0.125)
    course = angle + 0.5 * np.pi
    roll, half = 0.05, 0.5 * course
    cos, sin = np.cos(roll), np.sin(roll)
    quaternion = np.stack([np.cos(half) * cos, np.cos(half) * sin, np.sin(half) * sin, np.sin(half) * cos], axis=-1)
    error = np.linalg.norm(position - slot, axis=-1)
    names = ACTIONS[name]
    return TeamTrack(
        name=name,
        medium=MEDIA[name],
        position_n=position,
        quaternion_nb=quaternion,
        velocity_n=np.gradient(position, time, axis=0),
        target_n=slot[:, 0],
        target_course=np.arctan2(np.sin(course[:, 0]), np.cos(course[:, 0])),
        slot_n=slot,
        error_m=error,
        reward=np.exp(-error),
        action=np.ones((*angle.shape, len(names))),
        action_names=names,
        size_m=SIZES[name],
        wave_height=np.stack([elevation(*position[step, :, :2].T, now) for step, now in enumerate(time)]),
    )


def make_episode(vehicles: int = 3, teams: Sequence[str] = ("usv", "uav"), steps: int = 40, dt: float = 0.1) -> Episode:
    time = dt * np.arange(steps)
    angle = np.linspace(0.0, 2.0 * np.pi, 100)
    circle = RADIUS_M * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=-1)
    scene = Scene(
        area_m=300.0,
        tracks_n={name: circle - (0.0, 0.0, HEIGHTS[name]) for name in teams},
        checkpoints_n=circle[:88:4, :2],
        obstacles=np.array([[60.0, 10.0, 3.0, 20.0], [-70.0, 40.0, 2.0, 8.0]]),
    )
    events = (
        Event(0.5 * time[-1], teams[0], vehicles - 1, "collision", "obstacle 1"),
        Event(0.2 * time[-1], teams[0], 0, "stall", "alpha 0.4 rad"),
    )
    tracks = {name: circling_team(name, vehicles, time) for name in teams}
    return Episode("circle", time, tracks, elevation, scene, "# Run\n\nsea: one wave", events)


def column(path: Path, entity: str, component: str) -> tuple[NDArray, NDArray, NDArray]:
    """Times (ns), steps and values [rows, values of a row] of one component of one entity."""
    times, steps, values = rows(path, entity, component)
    return times, steps, np.array([np.ravel(row) for row in values])


def rows(path: Path, entity: str, component: str) -> tuple[NDArray, NDArray, list]:
    """Times (ns), steps and values of one component of one entity, row by row."""
    batches = [
        chunk.to_record_batch()
        for chunk in RrdReader(path).stream().filter(content=entity, is_static=False)
        if component in chunk.to_record_batch().schema.names
    ]
    times, steps, values = [], [], []
    for batch in batches:
        times += batch.column("sim_time").cast("int64").to_pylist()
        steps += batch.column("step").to_pylist()
        values += batch.column(component).to_pylist()
    order = np.argsort(steps, kind="stable")
    return np.array(times)[order], np.array(steps)[order], [values[row] for row in order]


def entities(path: Path) -> set[str]:
    return {chunk.entity_path for chunk in RrdReader(path).stream()}


def parts(container: rrb.Container) -> Iterator[rrb.View]:
    for part in container.contents:
        yield from parts(part) if isinstance(part, rrb.Container) else (part,)


def contents(view: rrb.View) -> list[str]:
    """What a view shows: its contents, or else all under its origin."""
    given = [view.contents] if isinstance(view.contents, str) else list(view.contents)
    return [f"/{one.replace('$origin', str(view.origin)).lstrip('/')}" for one in given]


def assert_nothing_is_empty(episode: Episode | Mapping[str, Episode], path: Path) -> None:
    """Every view has something to show, and a frame to show it in."""
    there = entities(path)
    seen = list(parts(blueprint(episode).root_container))
    for view in seen:
        pattern = [one.replace("/**", "*") for one in contents(view)]
        assert all(any(fnmatch(entity, one) for entity in there) for one in pattern), (view.name, pattern)
        if isinstance(view, rrb.Spatial3DView):
            assert f"/{view.origin}" in there
    titles = [str(view.name) for view in seen]
    assert len(set(titles)) == len(titles)
