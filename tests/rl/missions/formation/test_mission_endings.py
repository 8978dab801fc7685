"""How the mission ends: collisions, losses, capsizes, crashes, time."""

import math

import pytest
import torch
from small_missions import (
    TEAMS,
    begin,
    make,
    only,
    state,
    still,
)

from taichi_sim.kernels.rotation import torch_quaternion_from_euler


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
    assert step.endings[name]["collided"].equal(only(shared, 1, 2))
    assert step.terminated.tolist() == [False, True, False, False]
    assert not step.truncated.any()


def test_an_aircraft_above_an_obstacle_has_not_collided(shared):
    begin(shared)
    obstacles = shared.obstacles[shared.env_world[1]]
    low = obstacles[obstacles[:, 3].argmin()]
    state(shared, "uav")[1, 2, :2] = low[:2]
    state(shared, "uav")[1, 2, 2] = -low[3] - 10.0
    assert not shared.step(still(shared)).endings["uav"]["collided"].any()


@pytest.mark.parametrize("name", TEAMS)
def test_two_vehicles_on_the_same_spot_have_both_collided(shared, name):
    begin(shared)
    state(shared, name)[2, 1] = state(shared, name)[2, 2]
    step = shared.step(still(shared))
    assert step.endings[name]["collided"].equal(only(shared, 2, 1) | only(shared, 2, 2))
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
    assert step.endings[name]["lost"].equal(only(shared, 3, 1) & expected)


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
    assert step.endings["usv"]["capsized"].equal(only(shared, 0, 1) & expected)


@pytest.mark.parametrize(("altitude", "expected"), [(-5.0, True), (5.0, False)])
def test_an_aircraft_under_water_has_crashed(shared, altitude, expected):
    begin(shared)
    state(shared, "uav")[0, 1, 2] = -altitude
    step = shared.step(still(shared))
    assert step.endings["uav"]["crashed"].equal(only(shared, 0, 1) & expected)
    assert step.terminated.tolist() == [expected, False, False, False]


@pytest.mark.parametrize("bank", [0.0, -80.0, 80.0])
def test_an_aircraft_whose_lower_wing_touches_the_water_has_crashed(shared, bank):
    begin(shared)
    fleet, roll = shared.teams["uav"].fleet, torch.deg2rad(torch.tensor(bank))
    fleet.state[0, 1, 2] = -0.4 * fleet.model.size[1]
    fleet.state[0, 1, 3:7] = torch_quaternion_from_euler(roll, 0.0 * roll, 0.0 * roll)
    fleet.update()
    assert fleet.model.endings(fleet, shared.world)["crashed"].equal(only(shared, 0, 1) & (bank != 0.0))


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize(("beyond", "expected"), [(-20.0, False), (20.0, True)])
def test_a_vehicle_outside_the_area_has_left(shared, axis, beyond, expected):
    begin(shared)
    for sign in (-1, 1):
        state(shared, "usv")[0, 2, axis] = sign * (1500.0 + beyond)
        state(shared, "usv")[0, 2, 1 - axis] = 0.0
        step = shared.step(still(shared))
        assert step.endings["usv"]["left"].equal(only(shared, 0, 2) & expected)


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
