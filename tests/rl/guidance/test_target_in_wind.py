"""A target of constant airspeed: the wind triangle, what is refused, and where episodes start in wind."""

import math

import pytest
import taichi as ti
import torch
from torch import Tensor

from rl.guidance.targets_and_errors import Target, crab, speed_over_ground
from rl.missions import load_scenario
from rl.missions.formation.mission import Formation
from taichi_sim.config import ConfigError
from taichi_sim.kernels.rotation import torch_euler_from_quaternion

SMALL = ("track.worlds=4", "sea.realisations=4", "obstacles.count=0")
BREEZE = ("air.speed=7.72", "air.direction_deg=240", "air.std=0.5", "air.roughness=0.001")
ALOFT = math.log(60 / 0.001) / math.log(10 / 0.001)  # wind at 60 m, the paper's flight height, over that at 10 m
AIRSPEED = 20.0
UNIFORM = (
    "variation=0",
    "sensors.errors=0",
    "radio={}",
    'air.profile="uniform"',
    "air.std=0",
    'air.turbulence="none"',
    "air.direction_deg=240",
)


def make(*overrides: str, envs: int = 64, teams: tuple[str, ...] = ("uav",), scenario: str = "paper") -> Formation:
    return Formation(load_scenario(scenario, (*SMALL, *overrides)), envs, seed=1, teams=teams)


@pytest.fixture(scope="module")
def windy() -> Formation:
    return make('track.speed_over="air"', f"track.target_speed={AIRSPEED}", *BREEZE, teams=("usv", "uav"))


def refusal(*overrides: str, scenario: str = "aerosonde", teams: tuple[str, ...] = ("uav",)) -> str:
    with pytest.raises(ConfigError) as error:
        make(*overrides, envs=1, scenario=scenario, teams=teams)
    return str(error.value)


def over_ground(task: Formation, name: str = "uav") -> Tensor:
    target = task.teams[name].target
    return target.speed * torch.cat((target.course.cos(), target.course.sin()), dim=1)


def still(task: Formation) -> dict[str, Tensor]:
    return {name: torch.zeros_like(team.action) for name, team in task.teams.items()}


@ti.kernel
def _ground_speeds(out: ti.types.ndarray(ndim=1), airspeed: float, wind: ti.types.ndarray(ndim=2), course: float):
    for e in out:
        out[e] = speed_over_ground(airspeed, wind[e, 0], wind[e, 1], ti.cos(course), ti.sin(course))


def ground_speeds(airspeed: float, winds: list, course: float) -> list[float]:
    """Speed over ground (m/s) on `course` (rad) in each of `winds` (north, east, m/s)."""
    out = torch.zeros(len(winds))
    _ground_speeds(out, airspeed, torch.tensor(winds), course)
    return out.tolist()


# -- the triangle -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("course_deg", "speed"), [(0, 25 + 7), (180, 25 - 7), (90, 24), (-90, 24)])
def test_ground_speed_along_and_across_the_wind(course_deg, speed):
    """7-24-25: in a crosswind of 7 m/s an airspeed of 25 m/s leaves 24."""
    wind = [[7.0, 0.0]]  # blows to the north
    assert ground_speeds(25.0, wind, math.radians(course_deg)) == pytest.approx([speed], abs=1e-4)


def test_the_nose_is_turned_into_a_crosswind():
    """3-4-5: eastbound at 5 m/s in 3 m/s from the south, the nose is 36.87 deg to the right."""
    wind, cos, sin = torch.tensor([3.0, 0.0]), torch.tensor(0.0), torch.tensor(1.0)
    assert math.degrees(crab(5.0, wind, cos, sin).item()) == pytest.approx(36.8699, abs=1e-3)


def test_a_wind_that_leaves_too_little_is_met_at_the_least_speed():
    assert ground_speeds(25.0, [[-24.0, 0.0], [0.0, 40.0]], 0.0) == [5.0, 5.0]


# -- the target ---------------------------------------------------------------------------------------------------


def test_the_target_keeps_its_airspeed_in_the_wind_that_blows(windy):
    """|v - w| = V_a in every environment's own wind, which differs, at 60 m; the boats' target goes as fast."""
    windy.reset()
    for _ in range(3):
        windy.step(still(windy), begin=False)
        wind = ALOFT * windy.world.wind.velocity[:, :2]
        assert wind.norm(dim=1).std() > 0.3
        through = (over_ground(windy) - wind).norm(dim=1)
        torch.testing.assert_close(through, torch.full_like(through, AIRSPEED), atol=1e-4, rtol=0)
        assert windy.teams["usv"].target.speed.equal(windy.teams["uav"].target.speed)
    speed = windy.teams["uav"].target.speed
    assert speed.min() < AIRSPEED - 6 and speed.max() > AIRSPEED + 6


def test_the_target_moves_and_turns_as_it_says(windy):
    """Its place and course one interval later."""
    windy.reset()
    dt = windy.config.decision_interval
    before, target = windy.teams["uav"].targets.progress.clone(), windy.teams["uav"].target
    target = Target(target.table.clone(), target.position.clone())
    windy.step(still(windy), begin=False)
    later = windy.teams["uav"].target
    gone = windy.teams["uav"].targets.progress - before
    torch.testing.assert_close(gone, target.speed[:, 0] * dt, atol=1e-3, rtol=0)
    moved = (later.position - target.position)[:, :2].norm(dim=1)
    torch.testing.assert_close(moved, target.speed[:, 0] * dt, atol=0.02, rtol=0)
    turned = torch.remainder(later.course - target.course + math.pi, 2 * math.pi) - math.pi
    mean_rate = (target.course_rate + later.course_rate) / 2
    torch.testing.assert_close(turned, mean_rate * dt, atol=3e-4, rtol=0)
    assert turned.abs().max() > 0.01


def test_over_ground_the_wind_is_nothing_to_the_target():
    """The default: the same bits with and without a wind."""
    calm, windy = make(envs=4), make(*BREEZE, envs=4)
    for task in (calm, windy):
        task.reset(worlds=torch.arange(4), starts=torch.arange(4))
        task.step(still(task), begin=False)
        assert (task.teams["uav"].target.speed == task.config.track.target_speed).all()
    assert calm.teams["uav"].targets.progress.equal(windy.teams["uav"].targets.progress)
    assert calm.teams["uav"].target.course_rate.equal(windy.teams["uav"].target.course_rate)


def test_in_a_calm_air_and_ground_are_one():
    ground, air = make("air.speed=0", envs=4), make("air.speed=0", 'track.speed_over="air"', envs=4)
    for task in (ground, air):
        task.reset(worlds=torch.arange(4), starts=torch.arange(4))
        for _ in range(3):
            task.step(still(task), begin=False)
    torch.testing.assert_close(ground.teams["uav"].targets.progress, air.teams["uav"].targets.progress)
    torch.testing.assert_close(ground.teams["uav"].observations(), air.teams["uav"].observations(), atol=1e-5, rtol=0)


# -- starts -------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def aircraft() -> Formation:
    return make(*UNIFORM, scenario="aerosonde")


def test_aircraft_start_crabbed_and_trimmed(aircraft):
    """Their course over ground is the heading drawn; through the air they cruise; neither changes in 2 s."""
    worlds, starts = torch.arange(64) % 4, torch.arange(64) % 32
    aircraft.reset(worlds=worlds, starts=starts)
    drawn = torch_euler_from_quaternion(aircraft.starts.states["uav"][worlds, starts][..., 3:7])[..., 2]
    team = aircraft.teams["uav"].fleet
    wind = 7.72 * torch.tensor([math.cos(math.radians(60)), math.sin(math.radians(60))])
    for _ in range(10):
        v = team.velocity_n
        off = torch.remainder(torch.atan2(v[..., 1], v[..., 0]) - drawn + math.pi, 2 * math.pi) - math.pi
        assert off.abs().max() < 2e-3
        airspeed = (v - torch.nn.functional.pad(wind, (0, 1))).norm(dim=-1)
        assert (airspeed - 25.0).abs().max() < 0.05
        aircraft.drive(still(aircraft), begin=False)
    assert (team.euler[..., 2] - drawn).sin().abs().max() > math.sin(0.3)  # asin(7.72 / 25) = 0.31


def test_boats_start_at_their_share_of_the_speed_over_ground(windy):
    worlds, starts = torch.arange(64) % 4, torch.arange(64) % 32
    windy.reset(worlds=worlds, starts=starts)
    drawn = windy.starts.states["usv"][worlds, starts][..., 7] / AIRSPEED
    share = windy.teams["usv"].fleet.velocity_b[..., 0] / windy.teams["usv"].target.speed
    torch.testing.assert_close(share, drawn)


# -- refusals -----------------------------------------------------------------------------------------------------


def test_air_without_a_wind_is_refused():
    with pytest.raises(ConfigError, match=r"track\.speed_over.*\[air\] gives neither speed nor beaufort"):
        load_scenario("paper", ['track.speed_over="air"'])


def test_air_without_aircraft_is_refused():
    assert "track.speed_over = 'air': only usv is simulated" in refusal(teams=("usv",))


@pytest.mark.parametrize(
    ("overrides", "parts"),
    [
        (("track.target_speed=40",), ("track.target_speed = 40.0 over air", "'aerosonde'", "17 to 30.7 m/s")),
        (("air.speed=19",), ("track.target_speed = 23.5 over air", "up to 19 m/s", "less than 4.7 m/s")),
        (
            ('track.speed_over="ground"', "air.speed=5", "track.target_speed=20"),
            ("track.target_speed = 20.0 over ground", "15 to 25 m/s", "'aerosonde'", "17 to 30.7 m/s"),
        ),
    ],
)
def test_what_cannot_be_flown_is_refused_with_its_numbers(overrides, parts):
    message = refusal(*UNIFORM, *overrides)
    for part in parts:
        assert part in message


def test_the_wind_that_is_allowed_for_is_three_deviations_above_the_mean():
    """10 m/s and 3 x 3 m/s: 19 m/s."""
    assert "up to 19 m/s" in refusal(*UNIFORM, "air.speed=10", "air.std=3")


def test_a_wind_that_varies_counts_as_the_strongest_of_its_range():
    vary = ("air.speed=5", "vary.air.speed=[0, 9.5]")
    told = refusal(*UNIFORM, "air.std=3", *vary, "variation=1.2")
    assert "up to 19.4 m/s" in told  # 5 + 1.2 * 4.5 + 3 * 3 m/s
    make(*UNIFORM, *vary, envs=1, scenario="aerosonde")  # which sets variation = 0


@pytest.mark.parametrize(
    ("overrides", "speed"),
    [
        (('track.speed_over="air"', "track.target_speed=23", "air.speed=10"), 33.0),  # straight downwind
        (('track.speed_over="ground"', "track.target_speed=23", "air.speed=4"), 23.0),
    ],
)
def test_bends_must_be_wide_enough_for_the_largest_speed_over_ground(overrides, speed):
    """v^2 / (g tan 45 deg): 111 m at 33 m/s, 53.9 m at 23 m/s."""
    radius = speed**2 / 9.80665
    message = refusal(*UNIFORM, *overrides, f"track.min_radius={0.99 * radius}")
    assert "track.min_radius" in message and f"tighter than {radius:.3g} m at {speed:.3g} m/s" in message
    make(*UNIFORM, *overrides, f"track.min_radius={1.01 * radius}", envs=1, scenario="aerosonde")


def test_aircraft_start_on_courses_that_do_not_meet(aircraft):
    """Straight on for 3 s, each in its own steady flight, they keep more than the diameter of two, seen from above."""
    team = aircraft.teams["uav"].fleet
    for start in range(8):
        aircraft.reset(worlds=torch.arange(64) % 4, starts=(start + 8 * (torch.arange(64) // 16)))
        place, velocity = team.position_n[..., :2], team.velocity_n[..., :2]
        for t in torch.arange(0.0, 3.0, 0.1):
            later = place + t * velocity
            apart = torch.cdist(later, later) + 1e3 * torch.eye(3)
            assert apart.min() > 2 * aircraft.teams["uav"].radius


# -- observations -------------------------------------------------------------------------------------------------


def test_aircraft_observe_airspeed_and_wind(aircraft):
    """The terms, unscaled: the wind in b is that of the scenario, and velocity less wind is the airspeed."""
    aircraft.reset()
    generator = torch.Generator().manual_seed(0)
    team = aircraft.teams["uav"].fleet
    for _ in range(10):
        aircraft.drive({"uav": 2 * torch.rand(64, 3, 3, generator=generator) - 1}, begin=False)
    names = aircraft.teams["uav"].observation_names
    first = names.index("airspeed")
    seen = aircraft.teams["uav"].observations()[..., first : first + 4]
    assert names[first + 1 : first + 4] == ("wind.0", "wind.1", "wind.2")
    wind_b = 10.0 * seen[..., 1:] / (1 - seen[..., 1:].abs())
    blows = 7.72 * torch.tensor([math.cos(math.radians(60)), math.sin(math.radians(60)), 0.0])
    torch.testing.assert_close(wind_b, blows @ team.R_nb, atol=1e-3, rtol=0)
    low, _, high = team.model.limits.speeds
    airspeed = 25.0 + seen[..., 0] * (high - low) / 2
    torch.testing.assert_close(airspeed, (team.velocity_b - wind_b).norm(dim=-1), atol=2e-3, rtol=0)
    assert airspeed.std() > 0.1


def test_instruments_show_the_air_before_the_first_step(aircraft):
    """What a policy sees of a fresh episode is what it sees a step into it."""
    aircraft.reset()
    team = aircraft.teams["uav"].fleet
    names = [team.model.aux_names.index(n) for n in ("airspeed", "alpha", "beta", "wind_north", "wind_east")]
    before = team.aux[..., names].clone()
    assert (before[..., 0] - 25.0).abs().max() < 0.01
    aircraft.drive(still(aircraft), begin=False)
    torch.testing.assert_close(team.aux[..., names], before, atol=2e-2, rtol=0)


def test_what_has_no_air_data_observes_none():
    """The paper's aircraft see the same in a wind as in a calm."""
    calm, windy = make(envs=4), make(*BREEZE, envs=4)
    assert calm.teams["uav"].observations().shape == windy.teams["uav"].observations().shape
    for task in (calm, windy):
        task.reset(worlds=torch.arange(4), starts=torch.arange(4))
    assert calm.teams["uav"].observations().equal(windy.teams["uav"].observations())
