"""What is in a recording's file, and whether its layout shows anything that is not."""

from collections.abc import Iterator, Mapping
from fnmatch import fnmatch
from pathlib import Path

import rerun.blueprint as rrb
from rerun.chunk import RrdReader

from taichi_sim.visualisation.recording import Episode
from taichi_sim.visualisation.recording.blueprint import blueprint


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
