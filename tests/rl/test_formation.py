"""The mission through its public API: endings, resets, starts, determinism, observations, team sizes."""

import math

import pytest
import torch
from torch import Tensor

from rl.task.formation import FormationTask, Step
from rl.task.paths import Tracks
from rl.task.starts import Starts
from taichi_sim import runtime
from taichi_sim.config_io import load_scenario
from taichi_sim.conventions import TEAMS
from taichi_sim.maths.rotation import torch_quaternion_from_euler

SMALL = ("track.worlds=4", "sea.realisations=4")
AXES = {"usv": 2, "uav": 3}


@pytest.fixture(scope="module", autouse=True)
def taichi():
    runtime.init()


def make(*overrides: str, envs: int = 4, seed: int = 1, teams: tuple[str, ...] = TEAMS) -> FormationTask:
    return FormationTask(load_scenario("paper", (*SMALL, *overrides)), envs, seed=seed, teams=teams)


@pytest.fixture(scope="module")
def shared() -> FormationTask:
    """Return one task for all tests that begin with `begin`."""
    return make()


@pytest.fixture(scope="module")
def paper() -> FormationTask:
    """Return a task with the observations and rewards of the paper on a calm sea without obstacles."""
    return make('observations="paper"', 'reward="paper"', "sea.hs=0", "obstacles.count=0")


def begin(task: FormationTask, seed: int = 5) -> FormationTask:
    """Begin an episode in every environment, the same for the same seed."""
    task.reseed(seed)
    task.reset()
    return task


def shapes(task: FormationTask) -> dict[str, tuple[int, ...]]:
    return {n: (task.num_envs, t.section.count, len(t.action_names)) for n, t in task.teams.items()}


def still(task: FormationTask) -> dict[str, Tensor]:
    return {name: torch.zeros(shape) for name, shape in shapes(task).items()}


def wander(task: FormationTask, steps: int, seed: int = 0, size: float = 1.0) -> Step:
    """Step with random actions; return the last step."""
    generator = torch.Generator().manual_seed(seed)
    for _ in range(steps):
        step = task.step({n: size * (2 * torch.rand(s, generator=generator) - 1) for n, s in shapes(task).items()})
    return step


def state(task: FormationTask, name: str) -> Tensor:
    return task.teams[name].team.state


def only(task: FormationTask, env: int, vehicle: int) -> Tensor:
    flags = torch.zeros((task.num_envs, 3), dtype=torch.bool)
    flags[env, vehicle] = True
    return flags


# -- endings ----------------------------------------------------------------------------------------------


def test_an_ordinary_step_ends_nothing(shared):
    step = begin(shared).step(still(shared))
    assert not step.terminated.any() and not step.truncated.any()
    assert not any(e.any.any() for e in step.endings.values())


@pytest.mark.parametrize("name", TEAMS)
def test_a_vehicle_in_an_obstacle_has_collided(shared, name):
    begin(shared)
    obstacles = shared.obstacles[shared.env_world[1]]
    tall = obstacles[obstacles[:, 3].argmax()]
    state(shared, name)[1, 2, :2] = tall[:2]
    step = shared.step(still(shared))
    assert step.endings[name].collided.equal(only(shared, 1, 2))
    assert step.terminated.tolist() == [False, True, False, False]
    assert not step.truncated.any()


def test_an_aircraft_above_an_obstacle_has_not_collided(shared):
    begin(shared)
    obstacles = shared.obstacles[shared.env_world[1]]
    low = obstacles[obstacles[:, 3].argmin()]
    state(shared, "uav")[1, 2, :2] = low[:2]
    state(shared, "uav")[1, 2, 2] = -low[3] - 10.0
    assert not shared.step(still(shared)).endings["uav"].collided.any()


@pytest.mark.parametrize("name", TEAMS)
def test_two_vehicles_on_the_same_spot_have_both_collided(shared, name):
    begin(shared)
    state(shared, name)[2, 1] = state(shared, name)[2, 2]
    step = shared.step(still(shared))
    assert step.endings[name].collided.equal(only(shared, 2, 1) | only(shared, 2, 2))
    assert step.terminated.tolist() == [False, False, True, False]


@pytest.mark.parametrize("name", TEAMS)
@pytest.mark.parametrize(("away", "expected"), [(135.0, False), (165.0, True)])
def test_a_vehicle_is_lost_beyond_its_limit(shared, name, away, expected):
    """lost_distance is 150 m, and nothing moves 10 m in one step."""
    begin(shared)
    slot = shared.teams[name].now.slot[3, 1]
    place = slot.clone()
    place[0] -= away * torch.sign(slot[0])  # towards the centre of the area
    state(shared, name)[3, 1, :3] = place
    step = shared.step(still(shared))
    assert step.endings[name].lost.equal(only(shared, 3, 1) & expected)


@pytest.mark.parametrize(
    ("euler_deg", "expected"),
    [
        ((180, 0, 0), True),
        ((-110, 0, 0), True),
        ((0, 110, 0), True),  # bow over stern
        ((70, 0, 0), False),
        ((0, -70, 0), False),
        ((10, 10, 170), False),  # heading south is no capsize
    ],
)
def test_a_capsized_boat_is_found(shared, euler_deg, expected):
    begin(shared)
    euler = torch.deg2rad(torch.tensor(euler_deg, dtype=torch.float32))
    state(shared, "usv")[0, 1, 3:7] = torch_quaternion_from_euler(*euler)
    step = shared.step(still(shared))
    assert step.endings["usv"].capsized.equal(only(shared, 0, 1) & expected)


@pytest.mark.parametrize(("altitude", "expected"), [(-5.0, True), (5.0, False)])
def test_an_aircraft_under_water_has_crashed(shared, altitude, expected):
    begin(shared)
    state(shared, "uav")[0, 1, 2] = -altitude
    step = shared.step(still(shared))
    assert step.endings["uav"].crashed.equal(only(shared, 0, 1) & expected)
    assert step.terminated.tolist() == [expected, False, False, False]


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize(("beyond", "expected"), [(-20.0, False), (20.0, True)])
def test_a_vehicle_outside_the_area_has_left(shared, axis, beyond, expected):
    begin(shared)
    for sign in (-1, 1):
        state(shared, "usv")[0, 2, axis] = sign * (1500.0 + beyond)
        state(shared, "usv")[0, 2, 1 - axis] = 0.0
        step = shared.step(still(shared))
        assert step.endings["usv"].left.equal(only(shared, 0, 2) & expected)


def test_a_vehicle_whose_state_is_not_a_number_has_ended(shared):
    """A blown-up simulation must not go on for ever."""
    begin(shared)
    state(shared, "usv")[1, 2] = math.nan
    assert shared.step(still(shared)).terminated.tolist() == [False, True, False, False]
    begin(shared)


def test_time_runs_out_without_terminating():
    task = make("episode_duration=0.5", teams=("uav",))  # 5 decisions of 0.1 s
    for _ in range(4):
        step = task.step(still(task))
        assert not step.truncated.any() and not step.terminated.any()
    state(task, "uav")[2, 0, 2] = 5.0  # under water at the last moment
    step = task.step(still(task))
    assert step.truncated.tolist() == [True, True, False, True]
    assert step.terminated.tolist() == [False, False, True, False]


# -- resets and starts ------------------------------------------------------------------------------------


def everything(task: FormationTask, envs: list[int]) -> dict[str, Tensor]:
    """Copy all that an environment's future and observations depend on."""
    world = task.world
    parts = {
        "time": world.time,
        "sea": world.env_sea,
        "world": task.env_world,
        "progress": task.progress,
        "steps": task.steps,
    }
    for name, team in task.teams.items():
        parts[f"{name} state"], parts[f"{name} aux"] = team.team.state, team.team.aux
        parts[f"{name} distance"], parts[f"{name} slot"] = team.distance, team.now.slot
        parts[f"{name} gap"], parts[f"{name} target"] = team.sensor.gap, team.target.position
        parts[f"{name} observations"] = task.observe()[name]
    return {key: part[envs].clone() for key, part in parts.items()}


def test_a_reset_changes_only_the_given_environments(shared):
    begin(shared)
    wander(shared, 4)
    kept, renewed = everything(shared, [0, 2]), everything(shared, [1, 3])
    shared.reset(torch.tensor([1, 3]))
    for key, before in kept.items():
        assert everything(shared, [0, 2])[key].equal(before), key
    after = everything(shared, [1, 3])
    assert after["steps"].tolist() == [0, 0]
    for key in ("time", "progress", "usv state", "uav state", "usv observations"):
        assert not (after[key] == renewed[key]).all(), key


def test_the_future_of_other_environments_does_not_depend_on_a_reset(shared):
    def future(reset: bool) -> dict[str, Tensor]:
        begin(shared)
        wander(shared, 3)
        if reset:
            shared.reset(torch.tensor([1, 3]))
        wander(shared, 3, seed=1)
        return everything(shared, [0, 2])

    without = future(False)
    for key, part in future(True).items():
        assert part.equal(without[key]), key


def test_a_reset_of_nothing_changes_nothing(shared):
    begin(shared)
    wander(shared, 2)
    before = everything(shared, [0, 1, 2, 3])
    shared.reset(torch.zeros(0, dtype=torch.int64))
    for key, part in everything(shared, [0, 1, 2, 3]).items():
        assert part.equal(before[key]), key


def test_an_episode_begins_without_a_past(shared):
    begin(shared)
    wander(shared, 3)
    shared.reset(torch.tensor([1]))
    for name, rows in shared.observe().items():
        now, before = past_and_present(rows[1], AXES[name])
        assert now.equal(before), name
        # the last entries of "full" are the previous action and the role
        actions = len(shared.teams[name].action_names)
        assert not rows[1, :, -1 - actions : -1].any(), name
        assert rows[0, :, -1 - actions : -1].any(), name


CROWDS = {
    "the paper's": (),
    "astern": ('usv.formation="astern"', 'uav.formation="astern"'),
    "eight abreast": ("usv.count=8", "uav.count=8"),
    "eight astern": (
        "usv.count=8",
        "uav.count=8",
        'usv.formation="astern"',
        'uav.formation="astern"',
    ),
    "obstacles in the lanes": ("obstacles.clearance_min=-15", "obstacles.count=60"),
}


@pytest.mark.parametrize("crowd", CROWDS)
def test_starts_are_clear_of_obstacles_and_team_mates(crowd):
    task = make(*CROWDS[crowd], "track.worlds=32")
    for name, states in task.starts.states.items():
        place = states[..., :2]
        axis, radius = task.obstacles[:, None, None, :, :2], task.obstacles[:, None, None, :, 2]
        gap = (place.unsqueeze(3) - axis).norm(dim=-1) - radius - task.teams[name].radius
        hit = (gap.amin(dim=(2, 3)) <= 0).float().mean().item()
        assert hit == 0, f"{name}: {hit:.1%} of starts are in an obstacle"
        apart = (states[:, :, :, None, :3] - states[:, :, None, :, :3]).norm(dim=-1)
        apart = apart + 1e3 * torch.eye(apart.shape[-1])
        assert apart.min() > 2 * task.teams[name].radius, name


def test_starts_are_near_the_target_at_flight_height_and_under_way(shared):
    for name, states in shared.starts.states.items():
        world = torch.arange(4)[:, None].expand(shared.starts.progress.shape)
        target = shared.tracks.at(world, shared.starts.progress).position
        assert (states[:, :, 0, :2] - target).norm(dim=-1).max() <= 30.0 + 1e-3  # start_distance
        height = -states[..., 2]
        assert ((height - (60.0 if name == "uav" else 0.0)).abs() < 30.0).all()
        torch.testing.assert_close(states[..., 3:7].norm(dim=-1), torch.ones(states.shape[:-1]))
        assert (states[..., 7] > 0).all()


def test_a_start_is_where_the_episode_begins(shared):
    """The world and the start asked for are the ones got; boats are lifted onto the wave under them."""
    begin(shared)
    worlds, starts = torch.tensor([3, 0]), torch.tensor([7, 11])
    shared.reset(torch.tensor([2, 0]), worlds=worlds, starts=starts)
    assert shared.env_world[[2, 0]].equal(worlds)
    assert shared.progress[[2, 0]].equal(shared.starts.progress[worlds, starts])
    for name in TEAMS:
        expected = shared.starts.states[name][worlds, starts].clone()
        here = state(shared, name)[[2, 0]]
        if name == "usv":
            zeta = shared.world.elevation(torch.tensor([2, 0]), here[..., 0], here[..., 1])
            assert zeta.abs().max() > 0
            expected[..., 2] = -zeta
        torch.testing.assert_close(here, expected)


# -- determinism ------------------------------------------------------------------------------------------


def test_a_seed_determines_every_bit_and_another_changes_all():
    def history(seed: int) -> dict[str, Tensor]:
        task = make(seed=seed)
        wander(task, 3)
        task.reset(torch.tensor([0, 3]))
        wander(task, 2, seed=1)
        parts = everything(task, [0, 1, 2, 3])
        return parts | {
            "obstacles": task.obstacles,
            "track": task.tracks.table,
            "table": task.world.sea.table,
        }

    first, again, other = history(1), history(1), history(2)
    for key, part in first.items():
        assert part.equal(again[key]), key
    for key in ("obstacles", "track", "table", "time", "progress", "usv state", "uav state"):
        assert not first[key].equal(other[key]), key


def test_reseeding_replays_the_same_episodes(shared):
    def episode(seed: int) -> dict[str, Tensor]:
        begin(shared, seed)
        wander(shared, 2)
        return everything(shared, [0, 1, 2, 3])

    first, other, again = episode(5), episode(6), episode(5)
    for key, part in first.items():
        assert part.equal(again[key]), key
    assert not first["usv state"].equal(other["usv state"])


# -- observations -----------------------------------------------------------------------------------------


def past_and_present(rows: Tensor, axes: int) -> tuple[Tensor, Tensor]:
    """Current and previous distance and direction [.., 1 + axes], the first columns."""
    n = 1 + axes
    return rows[..., :n], rows[..., n : 2 * n]


# distance and direction, twice; 2 obstacles of (closeness, direction, width); mates of (closeness, direction)
PAPER_SIZE = {
    ("usv", 1): 2 * 3 + 2 * 4,
    ("usv", 2): 2 * 3 + 2 * 4 + 3,
    ("usv", 3): 2 * 3 + 2 * 4 + 2 * 3,
    ("usv", 8): 2 * 3 + 2 * 4 + 2 * 3,
    ("uav", 1): 2 * 4 + 2 * 5,
    ("uav", 2): 2 * 4 + 2 * 5 + 4,
    ("uav", 3): 2 * 4 + 2 * 5 + 2 * 4,
    ("uav", 8): 2 * 4 + 2 * 5 + 2 * 4,
}
# error, its rate, velocity, down axis, rates, course, turn, action, role
FULL_EXTRA = {"usv": 2 + 2 + 3 + 3 + 3 + 2 + 1 + 2 + 1, "uav": 3 + 3 + 3 + 3 + 3 + 3 + 1 + 3 + 1}


@pytest.mark.parametrize("count", [1, 2, 3, 8])
@pytest.mark.parametrize("formation", ["abreast", "astern"])
def test_every_team_size_and_formation_steps(count, formation):
    sizes = [f"{n}.{key}" for n in TEAMS for key in (f"count={count}", f"formation={formation}")]
    task = make(*sizes, envs=3)
    step = wander(task, 2)
    for name, rows in task.observe().items():
        assert rows.shape == (3, count, PAPER_SIZE[name, count] + FULL_EXTRA[name])
        assert rows.isfinite().all()
        assert step.reward[name].shape == (3, count)
        assert step.reward[name].isfinite().all()
        roles = torch.zeros(3, count)
        roles[:, 0] = 1.0
        assert rows[..., -1].equal(roles)


@pytest.mark.parametrize("seen", [0, 4])
def test_sensing_sets_the_size_of_observations(seen):
    sensing = (f"sensing.obstacles={seen}", f"sensing.team_mates={seen}")
    task = make(*sensing, 'observations="paper"', teams=("uav",))
    mates = min(seen, 2)  # there are no more
    assert task.observe()["uav"].shape == (4, 3, 2 * 4 + seen * 5 + mates * 4)


def test_paper_observations_have_their_size_and_bounds(paper):
    begin(paper)
    for i in range(10):
        wander(paper, 3, seed=i)
        for name, rows in paper.observe().items():
            assert rows.shape == (4, 3, PAPER_SIZE[name, 3])
            assert rows.isfinite().all()
            assert rows.abs().max() <= 1.0 + 1e-5


def test_full_observations_begin_with_those_of_the_paper(shared):
    paper = make('observations="paper"')
    for task in (shared, paper):
        begin(task)
        wander(task, 3)
    for name, rows in paper.observe().items():
        assert shared.observe()[name][..., : rows.shape[-1]].equal(rows)


def test_full_observations_are_bounded_where_they_should_be(shared):
    begin(shared)
    for i in range(10):
        wander(shared, 3, seed=i)
        for name, rows in shared.observe().items():
            n, axes = PAPER_SIZE[name, 3], AXES[name]
            error, attitude = rows[..., n : n + axes], rows[..., n + 2 * axes + 3 : n + 2 * axes + 6]
            course = rows[..., n + 2 * axes + 9 : n + 3 * axes + 9]
            action = rows[..., n + 3 * axes + 10 : -1]
            assert rows.isfinite().all()
            assert error.abs().max() < 1.0
            one = torch.ones(rows.shape[:2])
            torch.testing.assert_close(attitude.norm(dim=-1), one, atol=1e-4, rtol=0)
            assert course.abs().max() <= 1.0 + 1e-5
            assert action.abs().max() <= 1.0


def test_observations_are_a_fresh_tensor_each_time(shared):
    begin(shared)
    first = shared.observe()
    copies = {name: rows.clone() for name, rows in first.items()}
    assert all(rows.data_ptr() != first[name].data_ptr() for name, rows in shared.observe().items())
    wander(shared, 2)
    shared.reset(torch.tensor([0, 2]))
    shared.observe()
    for name, rows in first.items():
        assert rows.equal(copies[name])


@pytest.mark.parametrize("reset", [[], [1, 3]])
def test_the_previous_distance_and_direction_are_those_of_the_last_step(shared, reset):
    begin(shared)
    wander(shared, 2)
    last = {n: past_and_present(rows, AXES[n])[0] for n, rows in shared.observe().items()}
    wander(shared, 1)
    shared.reset(torch.tensor(reset, dtype=torch.int64))
    going_on = [env for env in range(4) if env not in reset]
    for name, rows in shared.observe().items():
        now, previous = past_and_present(rows, AXES[name])
        assert previous[going_on].equal(last[name][going_on])
        assert not now[going_on].equal(previous[going_on])
        assert now[reset].equal(previous[reset])
        torch.testing.assert_close(
            now[..., 1:].norm(dim=-1), torch.ones(now.shape[:2]), atol=1e-4, rtol=0
        )  # a unit vector


def arrange(
    task: FormationTask,
    name: str,
    offset: tuple[float, float, float],
    psi: float,
    theta: float = 0.0,
    phi: float = 0.0,
) -> Tensor:
    """Begin with the leader at `offset` (NED, m) from its target and an attitude; return its observation."""
    place = task.tracks.at(torch.zeros(1, dtype=torch.int64), task.starts.progress[0, :1])
    height = 0.0 if name == "usv" else 60.0
    start = task.starts.states[name][0, 0]
    start[:, :3] = torch.tensor([*place.position[0].tolist(), -height]) + torch.tensor(offset)
    start[1:, 0] += torch.tensor([20.0, -20.0])  # followers out of the way
    zero = torch.zeros(3)
    start[:, 3:7] = torch_quaternion_from_euler(zero + phi, zero + theta, zero + psi)
    zeros = torch.zeros(task.num_envs, dtype=torch.int64)
    task.reset(worlds=zeros, starts=zeros)
    return task.observe()[name][0, 0]


NORTH, EAST, SOUTH = 0.0, math.pi / 2, math.pi


@pytest.mark.parametrize(
    ("offset", "psi", "direction"),
    [
        ((-30.0, 0.0, 0.0), NORTH, (1, 0, 0)),  # target north of a northbound vehicle: ahead
        ((-30.0, 0.0, 0.0), EAST, (0, -1, 0)),  # north of an eastbound one: to port
        ((-30.0, 0.0, 0.0), SOUTH, (-1, 0, 0)),  # astern
        ((0.0, -30.0, 0.0), NORTH, (0, 1, 0)),  # east: to starboard
        ((0.0, -30.0, 0.0), EAST, (1, 0, 0)),
        ((0.0, 0.0, 30.0), EAST, (0, 0, -1)),  # 30 m above the aircraft
        ((-18.0, 0.0, -24.0), SOUTH, (-0.6, 0, 0.8)),  # astern and below: 3-4-5
    ],
)
def test_the_direction_is_in_the_body_frame(paper, offset, psi, direction):
    for name, n in AXES.items():
        if n == 3 or not offset[2]:  # boats observe the horizontal part
            observation = arrange(paper, name, offset, psi)
            # 30 m squashed: 30 / (30 + 10)
            expected = torch.tensor([0.75, *direction[:n]], dtype=torch.float32)
            torch.testing.assert_close(observation[: 1 + n], expected, atol=1e-4, rtol=0)


def test_an_aircraft_sees_the_target_from_its_attitude(paper):
    """A target 30 m ahead at the same height: below a raised nose, on the lower side of a bank when above."""
    raised = arrange(paper, "uav", (-30.0, 0.0, 0.0), NORTH, theta=math.pi / 6)
    expected = torch.tensor([0.75, math.sqrt(3) / 2, 0.0, 0.5])
    torch.testing.assert_close(raised[:4], expected, atol=1e-4, rtol=0)
    banked = arrange(paper, "uav", (0.0, 0.0, 30.0), NORTH, phi=math.pi / 2)  # right wing down, target above
    torch.testing.assert_close(banked[:4], torch.tensor([0.75, 0.0, -1.0, 0.0]), atol=1e-4, rtol=0)


def test_a_boat_sees_the_target_from_its_heading_alone(paper):
    upright = arrange(paper, "usv", (-30.0, -10.0, 0.0), NORTH)
    tossed = arrange(paper, "usv", (-30.0, -10.0, 0.0), NORTH, theta=0.4, phi=-0.5)
    torch.testing.assert_close(tossed[:6], upright[:6], atol=1e-4, rtol=0)


def test_an_aircraft_sees_its_team_mates_with_its_nose_straight_up(paper):
    """max_pitch_deg is 90, so this is an ordinary state: directions must not vanish in it."""
    observation = arrange(paper, "uav", (-30.0, 0.0, 0.0), NORTH, theta=math.pi / 2)
    mates = observation[-8:].view(2, 4)
    assert (mates[:, 0] > 0).all()  # 20 m away
    torch.testing.assert_close(mates[:, 1:].norm(dim=-1), mates[:, 0], atol=1e-3, rtol=0)


def test_the_distance_observed_grows_with_the_distance_and_stays_below_one(paper):
    squashed = [arrange(paper, "uav", (-d, 0.0, 0.0), NORTH)[0].item() for d in (1, 10, 40, 140)]
    assert squashed == pytest.approx([1 / 11, 1 / 2, 4 / 5, 14 / 15], abs=1e-4)  # d / (d + 10)


def rotated(task: FormationTask, angle: float) -> None:
    """Turn the world about the vertical: tracks, obstacles, starts."""
    c, s = math.cos(angle), math.sin(angle)
    R = torch.tensor([[c, s], [-s, c]])  # rows: v @ R turns v clockwise
    tracks = task.tracks
    table = torch.cat((tracks.table[..., :2] @ R, tracks.table[..., 2:]), dim=-1)
    table[..., 2] += angle
    task.tracks = Tracks(table, tracks.length_m, tracks.checkpoints @ R, tracks.checkpoint_s)
    task.obstacles = torch.cat((task.obstacles[..., :2] @ R, task.obstacles[..., 2:]), dim=-1).contiguous()
    zero = torch.zeros(())
    turn = torch_quaternion_from_euler(zero, zero, zero + angle)
    states = {}
    for name, old in task.starts.states.items():
        w, x, y, z = old[..., 3:7].unbind(-1)
        tw, tz = turn[0], turn[3]  # the product of a turn about the vertical with the attitude
        q = torch.stack((tw * w - tz * z, tw * x - tz * y, tw * y + tz * x, tw * z + tz * w), dim=-1)
        states[name] = torch.cat((old[..., :2] @ R, old[..., 2:3], q, old[..., 7:]), dim=-1)
    task.starts = Starts(task.starts.progress, states)


def test_observations_do_not_depend_on_where_north_is():
    """On a calm sea the same situation, turned about the vertical, looks and goes on the same."""
    crowded = ("obstacles.clearance_min=-20", "obstacles.count=120", "obstacles.radius_max=4", "area=4000")
    task = make("sea.hs=0", *crowded, envs=16)
    worlds, starts = torch.arange(16) % 4, torch.arange(16)

    def watch() -> list[dict[str, Tensor]]:
        task.reset(worlds=worlds, starts=starts)
        seen = [task.observe()]
        for i in range(4):
            wander(task, 2, seed=i)
            seen.append(task.observe())
        return seen

    generator = torch.Generator().manual_seed(0)
    for states in task.starts.states.values():  # no two team mates at the same distance: rounding would order them
        states[..., :2] += 0.3 * torch.randn(states[..., :2].shape, generator=generator)
    before = watch()
    sensed = before[0]["usv"][..., 6:14:4]
    assert (sensed > 0.3).any()  # obstacles near enough to matter
    rotated(task, 2.0)
    for old, new in zip(before, watch(), strict=True):
        for name in TEAMS:
            torch.testing.assert_close(new[name], old[name], atol=3e-3, rtol=0)


def test_what_is_out_of_range_is_observed_as_nothing(paper):
    """No obstacles, and team mates beyond the detection range of 40 m: closeness and direction are 0."""
    begin(paper)
    for name in TEAMS:
        start = paper.starts.states[name][0, 0]
        start[:, 0] = start[0, 0] + torch.tensor([0.0, 50.0, -50.0])
    zeros = torch.zeros(4, dtype=torch.int64)
    paper.reset(worlds=zeros, starts=zeros)
    for name, rows in paper.observe().items():
        beyond = rows[..., 2 * (1 + AXES[name]) :]
        assert not beyond.any(), f"{name}: {beyond[0, 0].tolist()}"


# -- rewards, as the mission gives them -------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "near", "far"),
    [
        ("usv", 2.9 - 0.02 * 50, 1 - 0.001 * 120),  # eq. (10)
        ("uav", 1.95 - 0.01 * 50, 1 - 0.0005 * 120),  # eq. (11)
    ],
)
def test_the_paper_rewards_a_leader_by_where_it_points(paper, name, near, far):
    """Behind the target on its course; one step changes the distance by a few metres at the most."""
    track = paper.tracks.at(torch.zeros(1, dtype=torch.int64), paper.starts.progress[0, :1])
    course = track.course.item()
    for metres, expected in ((50.0, near), (120.0, far)):
        behind = (-metres * math.cos(course), -metres * math.sin(course), 0.0)
        for turn, sign in ((0.0, 1.0), (math.pi, -1.0)):
            arrange(paper, name, behind, course + turn)
            reward = paper.step(still(paper)).reward[name][:, 0]
            torch.testing.assert_close(reward, torch.full((4,), sign * expected), atol=0.12, rtol=0)


@pytest.mark.parametrize("name", TEAMS)
def test_the_paper_takes_one_for_a_collision(paper, name):
    """A follower with another on the same spot, or 3 m clear of it: the rest of its reward is equal."""
    begin(paper)
    team = paper.teams[name]
    arrange(paper, name, (-30.0, 0.0, 0.0), NORTH)

    def reward(offset: float) -> tuple[Tensor, Tensor]:
        zeros = torch.zeros(4, dtype=torch.int64)
        paper.reset(worlds=zeros, starts=zeros)
        state(paper, name)[:, 2] = state(paper, name)[:, 1]
        state(paper, name)[:, 2, 1] += offset
        step = paper.step(still(paper))
        return step.reward[name][:, 1], step.endings[name].collided[:, 1]

    apart, hit = reward(2 * team.radius + 3.0), reward(0.0)
    assert hit[1].all() and not apart[1].any()
    torch.testing.assert_close(hit[0], apart[0] - 1.0, atol=1e-3, rtol=0)


def test_tracking_rewards_the_slot_more_than_any_other_place(shared):
    """The same boat with the same motion, ever further from its slot, earns ever less."""
    rewards = []
    for away in (0.0, 2.0, 5.0, 20.0, 60.0):
        begin(shared)
        slot = shared.teams["usv"].now.slot[0, 2]
        state(shared, "usv")[0, 2, :2] = slot[:2] - away * slot[:2] / slot[:2].norm()
        rewards.append(shared.step(still(shared)).reward["usv"][0, 2].item())
    assert rewards == sorted(rewards, reverse=True)


# -- actions ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", TEAMS)
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_an_action_that_is_not_finite_is_refused_and_nothing_moves(shared, name, value):
    begin(shared)
    wander(shared, 1)
    before = everything(shared, [0, 1, 2, 3])
    actions = {n: a + 0.5 for n, a in still(shared).items()}
    actions[name][2, 1, 1] = value
    with pytest.raises(ValueError, match=f"{name}.*'yaw'.*vehicle 1.*environment 2.*{value}"):
        shared.step(actions)
    for key, part in everything(shared, [0, 1, 2, 3]).items():
        assert part.equal(before[key]), key


@pytest.mark.parametrize("shape", [(4, 3), (3, 3, 2), (4, 2, 2), (4, 3, 3)])
def test_actions_of_another_shape_are_refused(shared, shape):
    begin(shared)
    before = everything(shared, [0, 1, 2, 3])
    with pytest.raises(ValueError, match=r"usv.*shape.*expected \(4, 3, 2\)"):
        shared.step(still(shared) | {"usv": torch.zeros(shape)})
    for key, part in everything(shared, [0, 1, 2, 3]).items():
        assert part.equal(before[key]), key


def test_actions_beyond_the_range_are_clipped(shared):
    def outcome(clip: bool) -> dict[str, Tensor]:
        begin(shared)
        generator = torch.Generator().manual_seed(2)
        for _ in range(3):
            actions = {n: 3 * torch.randn(s, generator=generator) for n, s in shapes(shared).items()}
            assert max(a.abs().max() for a in actions.values()) > 2
            shared.step({n: a.clamp(-1, 1) if clip else a for n, a in actions.items()})
        return everything(shared, [0, 1, 2, 3])

    clipped = outcome(True)
    for key, part in outcome(False).items():
        assert part.equal(clipped[key]), key


def test_a_step_does_not_write_to_the_actions_given(shared):
    begin(shared)
    actions = {n: a + 2.0 for n, a in still(shared).items()}
    shared.step(actions)
    shared.reset(torch.tensor([0]))
    assert all((a == 2.0).all() for a in actions.values())


# -- variants ---------------------------------------------------------------------------------------------


def test_the_boats_alone_do_as_they_do_with_aircraft_above():
    """The teams share the target's track and the sea, and nothing else."""
    alone, both = make("sea.hs=0", teams=("usv",)), make("sea.hs=0")
    assert list(alone.observe()) == ["usv"]
    worlds, starts = torch.arange(4), torch.arange(4)
    for task in (alone, both):
        task.reset(worlds=worlds, starts=starts)
        for _ in range(3):
            task.step({n: a + 0.3 for n, a in still(task).items()})
    torch.testing.assert_close(state(alone, "usv"), state(both, "usv"))


def test_without_obstacles_nothing_is_in_the_way(paper):
    begin(paper)
    step = wander(paper, 3)
    assert not any(e.collided.any() for e in step.endings.values())
    for name, rows in paper.observe().items():
        first = 2 * (1 + AXES[name])
        directions = rows[..., first : first + 6].unflatten(-1, (2, 3))[..., 1:]
        assert not directions.any()


def test_followers_astern_have_slots_behind_the_leader():
    task = make('usv.formation="astern"', "usv.spacing=20", "sea.hs=0", teams=("usv",))
    wander(task, 2)
    team = task.teams["usv"]
    course = torch.stack((team.target.course.cos(), team.target.course.sin()), dim=-1)
    leader = state(task, "usv")[:, 0, :2]
    for i in (1, 2):
        torch.testing.assert_close(team.now.slot[:, i, :2], leader - 20.0 * i * course, atol=1e-3, rtol=0)
    torch.testing.assert_close(team.now.slot[:, 0], team.target.position)


def test_the_target_moves_at_its_speed(shared):
    begin(shared)
    shared.reset(worlds=torch.arange(4), starts=torch.zeros(4, dtype=torch.int64))
    before = shared.teams["usv"].target.position.clone()
    for _ in range(5):
        shared.step(still(shared))
    moved = (shared.teams["usv"].target.position - before).norm(dim=-1)
    # 12 m/s for 0.5 s; a chord in a bend of 100 m is 6^3 / (24 100^2) = 1 mm shorter than its arc
    torch.testing.assert_close(moved, torch.full((4,), 6.0), atol=0.01, rtol=0)
