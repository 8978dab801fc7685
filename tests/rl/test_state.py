"""Snapshots, copies and forks: exact, complete, and refused where they cannot be."""

import dataclasses
import io
from collections import deque

import numpy as np
import pytest
import torch
from everything import differences, everything
from folders import PLUGINS

from rl.learn.policy import ClassicalPolicy
from rl.mission import Mission
from rl.missions import load_scenario, make_mission
from taichi_sim.state import snapshot
from taichi_sim.state.memory import Remembers
from taichi_sim.state.snapshot import StateError, Stateful
from taichi_sim.world import World

PLUGIN = PLUGINS / "buoys.toml"
SMALL = ("track.worlds=8", "sea.realisations=4")
SCENARIOS = {
    "lanes": SMALL,
    "otter": (*SMALL, "usv.formation.change_every=4", 'usv.formation.shapes=["abreast","wedge"]'),
    "aerosonde": (*SMALL, "air.std=1.0"),
    "escort": ("escort.worlds=8", "sea.realisations=4", "sea.components=6"),
    "landing": (
        "sea.realisations=4",
        "landing.distance=[2.0, 6.0]",
        "landing.height=[2.0, 4.0]",
        "uav.pilot.kind=forecast",
    ),
    "station": ("sea.realisations=4", "station.hold=2"),
    "encounter": ("sea.realisations=4", "encounter.notice=240"),
    str(PLUGIN): (),
}
QUICK = "lanes", "otter", "escort"
NAMED = [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in SCENARIOS]
# What steps write anew before anybody reads it, and what is asked for again.
SCRATCH = (
    "._wanted",
    ".ordered",  # as of the last command, which comes anew
    "].parts[",  # of the last reward
    ".members['turns']",
    ".members['remainder']",  # of copies of a group's last vehicle; those of vehicles are `Fleet.remainder`
    ".members['rests']",
    "._which",
    ".members['way']",
    ".members['place']",
    "].before",
    "._few[",  # written anew before each use
    "._seas_of",  # says what has been checked
)


def begun(name: str, envs: int = 5, seed: int = 1) -> Mission:
    """A mission of a scenario in short episodes, so that resets come between."""
    source = PLUGIN if name == str(PLUGIN) else None
    settles = () if name in ("escort", "landing") else ("evaluation.settle=1",)
    short = ("episode_duration=6", *settles)
    return make_mission(load_scenario(name, (*SCENARIOS[name], *short)), envs, seed=seed, source=source)


class Driver:
    """Random commands, the same for the same seed; environments that end begin anew."""

    def __init__(self, mission: Mission, seed: int = 0):
        self.mission, self.generator = mission, torch.Generator().manual_seed(seed)

    def actions(self, envs: int) -> dict[str, torch.Tensor]:
        return {
            name: 2 * torch.rand((envs, team.fleet.count, len(team.action_names)), generator=self.generator) - 1
            for name, team in self.mission.teams.items()
        }

    def go(self, steps: int) -> list[dict[str, np.ndarray]]:
        """What every team observes, and is paid."""
        found = []
        for _ in range(steps):
            given = self.actions(self.mission.num_envs)
            step = self.mission.step(given)
            seen = {name: seen.numpy().copy() for name, seen in step.observations.items()}
            found.append(seen | {f"{name} reward": step.reward[name].numpy().copy() for name in seen})
        return found


def same(a: list[dict[str, np.ndarray]], b: list[dict[str, np.ndarray]]) -> bool:
    return all(x.keys() == y.keys() and all(x[k].tobytes() == y[k].tobytes() for k in x) for x, y in zip(a, b))  # noqa: B905


def test_what_comes_after_a_restore_is_what_came_before():
    for name in ("lanes", str(PLUGIN)):
        repeated(name, 40)


@pytest.mark.slow
@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("name", SCENARIOS)
def test_a_thousand_random_steps_after_a_restore(name, threads, precision):
    from taichi_sim.kernels import runtime

    runtime.init(precision=precision, threads=threads)
    repeated(name, 1000)


def repeated(name: str, steps: int) -> None:
    mission = begun(name)
    driver = Driver(mission)
    driver.go(7)
    saved, drawn, all_of_it = mission.snapshot(), driver.generator.get_state(), everything(mission)
    before = driver.go(steps)
    changed = differences(all_of_it, everything(mission))
    assert len(changed) > 10, "the steps must change something"
    mission.restore(saved)
    forgotten = [path for path in differences(all_of_it, everything(mission)) if not ignored(path)]
    assert not forgotten, f"{name}: a snapshot forgets {forgotten}"
    driver.generator.set_state(drawn)
    assert same(before, driver.go(steps)), name


def ignored(path: str) -> bool:
    return any(part in path for part in SCRATCH)


def test_a_snapshot_outlives_its_mission(tmp_path):
    """Written to a file, and restored into a mission that is new."""
    mission = begun("otter")
    Driver(mission).go(9)
    file = io.BytesIO()
    torch.save(dataclasses.asdict(mission.snapshot()), file)
    before = Driver(mission, 5).go(12)
    file.seek(0)
    other = begun("otter")
    other.restore(snapshot.Snapshot(**torch.load(file, weights_only=False)))
    assert same(before, Driver(other, 5).go(12))


@pytest.mark.parametrize("name", ["lanes", "otter"])
def test_a_fork_that_shares_the_noise_does_what_its_source_does(name):
    """Sizes lie on one side of where kernels begin to use threads (`runtime.Launcher`): the bits are the same."""
    mission = begun(name, 4)
    driver = Driver(mission)
    driver.go(5)
    fork = mission.fork([2, 0], 2)
    rows = torch.tensor([2, 2, 0, 0])
    for again in range(2):
        for _ in range(10):
            given = driver.actions(mission.num_envs)
            mission.step(given, begin=False)
            fork.step({n: action[rows] for n, action in given.items()}, begin=False)
            for n, team in mission.teams.items():
                assert team.observations()[rows].equal(fork.teams[n].observations()), (name, n, again)
        mission.fork([2, 0], 2, into=fork)


@pytest.fixture(scope="module")
def sailed() -> Mission:
    """A mission under way, for tests that only fork it."""
    mission = begun("otter", 4)
    Driver(mission).go(5)
    return mission


def test_a_fork_that_draws_its_own_noise_differs_in_what_is_measured_alone(sailed):
    shared, own = sailed.fork([1], 4), sailed.fork([1], 4, noise="own")
    for fork in (shared, own):
        fork.drive({n: torch.zeros_like(team.fleet.action) for n, team in fork.teams.items()})
    measured = [fork.teams["usv"].known.fleet.state[:, 0, 0] for fork in (shared, own)]
    assert len(measured[0].unique()) == 1 and len(measured[1].unique()) == 4
    truth = [fork.teams["usv"].fleet.state[:, 0, 0] for fork in (shared, own)]
    assert truth[0].equal(truth[1])


def test_forks_and_their_forks_never_draw_the_same_noise_of_their_own(sailed):
    one = sailed.fork([1], 3, noise="own")
    forks = [one, sailed.fork([1], 3, noise="own"), one.fork([0], 3, noise="own"), sailed.fork([1], 3, noise="own")]
    assert len(torch.cat([fork.noise.keys for fork in forks]).unique()) == 12
    assert all(fork.world.noise.keys.equal(fork.noise.keys) for fork in forks)
    for fork in forks:
        fork.step({n: torch.zeros_like(team.fleet.action) for n, team in fork.teams.items()})
    measured = torch.cat([fork.teams["usv"].known.fleet.state[:, 0, 0] for fork in forks])
    assert len(measured.unique()) == 12


@pytest.mark.parametrize("name", NAMED)
def test_kept_states_go_on_in_a_mission_of_another_size(name):
    """To the bit where they share the noise; apart where they draw their own."""
    mission, other = begun(name, 5), begun(name, 3)
    driver = Driver(mission)
    driver.go(7)
    Driver(other, 3).go(7)
    kept, saved = mission.keep([4, 0, 4, 2]).pick(torch.tensor([0, 3])), mission.snapshot()
    joined = kept.joined(mission.keep([0]))
    driver.go(3)  # what is kept stays as it was
    mission.restore(saved)
    other.put(joined, [2, 0, 1], noise="shared")
    rows = torch.tensor([2, 0, 4])
    for _ in range(6):
        given = driver.actions(5)
        mission.step(given, begin=False)
        other.step({n: of[rows] for n, of in given.items()}, begin=False)
        for n, team in mission.teams.items():
            assert team.observations()[rows].equal(other.teams[n].observations()), n
    other.put(joined, [2, 0, 1])
    assert len(torch.cat((other.noise.keys, mission.noise.keys)).unique()) == 8


def test_kept_states_that_do_not_fit_are_refused_and_nothing_is_written():
    mission = begun("otter", 3)
    kept, before = mission.keep([0, 1]), mission.snapshot()
    cases = {
        "2 kept states for 1 envs": lambda: mission.put(kept, [0]),
        "name environment 0 twice": lambda: mission.put(kept, [0, 0]),
        "noise = 'none'": lambda: mission.put(kept, [0, 1], noise="none"),
        "seed 2 instead of 1|seed 1 instead of 2": lambda: begun("otter", 3, seed=2).put(kept, [0, 1]),
        "there are 0 to 2": lambda: mission.keep([3]),
    }
    for text, call in cases.items():
        with pytest.raises(StateError, match=text):
            call()
    after = mission.snapshot()
    assert all(a.equal(b) for a, b in zip(before.values.values(), after.values.values(), strict=True)
               if isinstance(a, torch.Tensor))  # fmt: skip


@pytest.mark.parametrize("name", NAMED)
def test_an_episode_draws_nothing_from_a_generator_as_it_goes_on(name):
    """Else its copies could not part."""
    mission = begun(name, 3)
    driver = Driver(mission)

    def generators():
        found = (entry.value for entry in snapshot.walk(mission).entries)
        return torch.cat([value.get_state() for value in found if isinstance(value, torch.Generator)])

    before = generators()
    for _ in range(20):
        mission.step(driver.actions(3), begin=False)
    assert before.equal(generators())


def test_copies_within_a_mission_are_what_they_are_of():
    mission = begun("otter", 6)
    driver = Driver(mission)
    driver.go(8)
    mission.copy([1, 1, 4], [0, 5, 3])
    for _ in range(8):
        given = {n: a[[1, 1, 2, 4, 4, 1]] for n, a in driver.actions(6).items()}
        mission.step(given, begin=False)
        seen = mission.teams["usv"].observations()
        assert seen[0].equal(seen[1]) and seen[5].equal(seen[1]) and seen[3].equal(seen[4])


def test_a_world_without_a_mission_forks_too():
    world = World.from_scenario("otter", 3, overrides=SMALL, teams=("usv",))
    world.step({"usv": torch.ones_like(world.teams["usv"].action)})
    fork, saved = world.fork([2, 2, 1], 2), world.snapshot()
    tracks = []
    for _ in range(2):
        for of in (world, fork):
            of.step({"usv": 0.5 * torch.ones_like(of.teams["usv"].action)})
        tracks.append(world.teams["usv"].state.clone())
        assert tracks[-1][[2, 2, 2, 2, 1, 1]].equal(fork.teams["usv"].state)
        world.restore(saved)
        world.fork([2, 2, 1], 2, into=fork)
    assert tracks[0].equal(tracks[1])


def test_numbers_and_loads_that_were_given_between_are_taken_back():
    world = World.from_scenario("lanes", 2, teams=("usv",))
    fleet, action = world.teams["usv"], {"usv": torch.ones((2, 3, 2))}
    saved = world.snapshot()
    world.step(action)
    plain = fleet.state.clone()
    fleet.load[..., 0] = 50.0
    fleet.set_numbers({fleet.model.varying[0]: 1.3 * fleet.model.nominal[fleet.model.varying[0]]})
    world.step(action)
    heavy = world.snapshot()
    world.restore(saved)
    assert not fleet.varied and not fleet.loaded
    world.step(action)
    assert fleet.state.equal(plain)
    world.restore(heavy)
    assert fleet.varied and float(fleet.load[0, 0, 0]) == 50.0


class Part(Remembers):
    """A part that remembers a tensor."""

    def __init__(self):
        self.table = self.remember(torch.zeros(3, 2))
        self.view = self.table[:, 0]


class Buoy(Stateful):
    """What somebody's world may hold."""

    num_envs = 3

    def __init__(self):
        self.place, self.part = self.remember(torch.zeros(3, 2)), self.remember(Part())
        self.rng, self.drawn = self.share(np.random.default_rng(1)), self.share(0)
        self.nested = self.remember({"x": torch.zeros(3), "n": 4, "parts": [Part()]})
        self.way, self.limit, self.same = self.scratch(torch.zeros(3)), torch.ones(2), self.part.view


def test_what_is_declared_is_found_and_what_was_forgotten_is_named():
    buoy = Buoy()
    assert {entry.path.removeprefix("Buoy."): entry.of_env for entry in snapshot.walk(buoy).entries} == {
        "place": True, "part.table": True, "rng": False, "drawn": False, "nested['x']": True, "nested['n']": False,
        "nested['parts'][0].table": True,
    }  # fmt: skip
    buoy.place, buoy.drawn, buoy.way = buoy.place + 1, 1, torch.ones(3)
    buoy.part.table[0] = buoy.way[0] = 2.0  # views of what is declared, too
    snapshot.walk(buoy)

    def again(buoy):
        buoy.limit = torch.zeros(2)

    def removed(buoy):
        del buoy.place

    forgotten = {
        r"Buoy\.limit is assigned again, .* self\.limit = self\.remember": again,
        r"Buoy\.place was declared by self\.remember\(\.\.\.\) and is gone": removed,
        r"Buoy\.place is declared twice": lambda b: setattr(b, "place", b.share(torch.zeros(3, 2))),
        r"Buoy\.nested is a collections\.deque, .* derive its class": lambda b: setattr(b, "nested", deque([1])),
    }
    for told, forget in forgotten.items():
        buoy = Buoy()
        with pytest.raises(StateError, match=told):
            forget(buoy)
            snapshot.walk(buoy)


def test_a_snapshot_makes_the_controllers_whose_memory_it_holds():
    mission, other = begun("otter", 3), begun("otter", 3)
    team = mission.teams["usv"]
    for _ in range(3):
        mission.step(dict.fromkeys(mission.teams, ClassicalPolicy()))
    saved, drift = mission.snapshot(), team.controller.course.drift.clone()
    assert saved.made == ("usv", "uav")
    other.restore(saved)
    assert other.teams["usv"].controller.course.drift.equal(drift)
    assert mission.fork([0], 3).teams["usv"].controller.course.drift.equal(drift[[0, 0, 0]])


def test_what_cannot_be_is_refused_and_nothing_is_written(monkeypatch):
    mission, other = begun("lanes", 3), begun("lanes", 4)
    saved, fewer = mission.snapshot(), World(mission.config, 3, teams=["usv"])
    everywhere = everything(mission)
    wrong = {
        "3 environments, version .*; wanted are 4": lambda: other.restore(saved),
        "seed 2 instead of 1": lambda: mission.restore(begun("lanes", 3, seed=2).snapshot()),
        "'otter' instead of 'lanes'": lambda: mission.restore(begun("otter", 3).snapshot()),
        "version 0": lambda: mission.restore(dataclasses.replace(saved, version=0)),
        "the snapshot is none": lambda: mission.restore({}),
        "name environment 3: there are 0 to 2": lambda: mission.fork([0, 3], 2),
        "environment 1 twice": lambda: mission.copy([0, 2], [1, 1]),
        "1 source_envs for 2": lambda: mission.copy([0], [1, 2]),
        "nothing in it": lambda: mission.fork([], 2),
        "copies = 0 must be a whole": lambda: mission.fork([0], 0),
        "copies = 2.0 must be a whole": lambda: mission.fork([0], 2.0),  # type: ignore[arg-type]
        "into = 'x': an earlier fork": lambda: mission.fork([0], into="x"),
        "teams usv, uav, with the same": lambda: mission.world.fork([0], 3, into=fewer),
        "noise = 'none'": lambda: mission.fork([0], 2, noise="none"),  # type: ignore[arg-type]
        "the fork has 6 of Formation": lambda: mission.fork([0, 1], 3, into=other),
        "not torch.float32": lambda: mission.fork(torch.tensor([0.5]), 2),
    }
    for told, call in wrong.items():
        with pytest.raises(StateError, match=told):
            call()
    monkeypatch.setattr(snapshot, "_free_memory", lambda: 1e6)
    with pytest.raises(StateError, match=r"100000 environments would take about \d.* GiB of memory; 0\.0 GiB are free"):
        mission.fork([0], 100_000)
    assert not differences(everywhere, everything(mission))
