"""The autopilot in calm air: steps, coordinated turns, envelope protection, what is refused; both aircraft."""

import math

import numpy as np
import pytest
import torch

from taichi_sim.bench import Bench
from taichi_sim.config import ConfigError
from taichi_sim.kernels.conventions import GRAVITY
from taichi_sim.models.uav.fixed_wing.trim import linear_modes

pytestmark = pytest.mark.usefixtures("f64")
DT, SUBSTEPS = 0.02, 5
HEIGHT = 100.0  # m, of the start


@pytest.fixture(scope="module")
def aircraft(f64, make_model):
    """Maker of a model: aircraft(name, actions, protection); each only once."""
    made = {}

    def make(name="aerosonde", actions="altitude", protection=True):
        key = (name, actions, protection)
        if key not in made:
            made[key] = make_model(name, DT, SUBSTEPS, autopilot={"actions": actions, "protection": protection})
        return made[key]

    return make


class Flight(Bench):
    """One aircraft, from cruise toward north; `rows` holds what it read at each control step."""

    def __init__(self, model):
        super().__init__(model)
        self.put((0.0, 0.0, -HEIGHT), settle=True)
        self.rows: list[dict] = []

    def fly(self, seconds, action):
        """`action` is three (or four) numbers, or a function of this flight."""
        for _ in range(round(seconds / (DT * SUBSTEPS))):
            self.step(action(self) if callable(action) else action)
            phi, theta, psi = self.euler
            readings = dict(zip(self.model.aux_names, self.aux[0, 0].tolist(), strict=True))
            angles = {"phi": phi, "theta": theta, "psi": psi, "course": self.course}
            self.rows.append(readings | angles | {"height": -self.position[2]})
        return self

    @property
    def course(self):
        """Direction of the velocity over the ground, rad."""
        north, east, _ = self.velocity
        return math.atan2(east, north)

    def column(self, name):
        """A reading at every step."""
        return np.array([row[name] for row in self.rows])

    def settles(self, name, value, band, within):
        """Whether it stays within `band` of `value` from `within` seconds on."""
        return np.abs(self.column(name)[round(within / (DT * SUBSTEPS)) :] - value).max() < band


@pytest.fixture
def flight(aircraft):
    return lambda *args: Flight(aircraft(*args))


def to_course(course):
    """Fly level on a course (rad)."""

    def action(flight):
        speed = float(np.hypot(*flight.velocity[:2]))
        return [0.0, float(flight.model.turn(torch.tensor(course - flight.course), speed)), 0.0]

    return action


# -- gains -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["aerosonde", "zagi"])
def test_every_closed_loop_is_damped(name, aircraft):
    """Eigenvalues of the linear aircraft with servos, motor and all loops: stable, and none damped less than 0.12 (the
    rudderless Zagi's Dutch roll) or 0.3.
    """
    model = aircraft(name)
    g, p, linear, V = model.gains, model.p.actuators, linear_modes(model.p, model.cruise), model.cruise.airspeed
    lag = p.time_constant + DT / 2
    lon, lat = np.zeros((7, 7)), np.zeros((6, 6))
    lon[:4, :4], lon[:4, 4:6] = linear.A_lon, linear.B_lon
    lon[4] = np.array([0, 0, -g.pitch_rate, -g.pitch * math.cos(model.cruise.theta), -1, 0, 0]) / lag
    lon[5] = np.array([-g.throttle_airspeed, 0, 0, 0, 0, -1, 1]) / (p.throttle_time_constant + DT / 2)
    lon[6, 0] = -g.throttle_integral
    lat[:4, :4], lat[:4, 4:] = linear.A_lat, linear.B_lat
    lat[4] = np.array([0, -g.roll_rate, 0, -g.roll, -1, 0]) / lag
    lat[5] = np.array([0, 0, -g.yaw_rate, g.yaw_rate * GRAVITY / V, 0, -1]) / lag
    for matrix, least in ((lon, 0.3), (lat, 0.3 if name == "aerosonde" else 0.12)):
        values = np.linalg.eigvals(matrix)
        assert (values.real / np.abs(values)).max() < -least


# -- steps -------------------------------------------------------------------------------------------------------


def test_zero_action_is_cruise(flight):
    flown = flight().fly(5.0, [0.0, 0.0, 0.0])
    assert flown.settles("height", HEIGHT, 1e-3, 0.0) and flown.settles("airspeed", 25.0, 1e-3, 0.0)
    assert flown.settles("phi", flown.model.cruise.phi, 1e-3, 0.0)


def test_turn_of_30_degrees(flight):
    """Within 1 deg from 3 s on, no more than 1 deg too far, height kept to 0.3 m, sideslip below 1 deg."""
    flown = flight().fly(10.0, to_course(math.radians(30)))
    assert flown.settles("course", math.radians(30), math.radians(1), 3.0)
    assert flown.column("course").max() < math.radians(31)
    assert flown.settles("height", HEIGHT, 0.3, 0.0)
    assert np.abs(flown.column("beta")).max() < math.radians(1)
    assert np.abs(flown.column("phi")).max() < math.radians(46)


def test_climb_of_20_metres(flight):
    """Within 0.5 m from 7 s on, never below the start, at most 0.3 m too high, airspeed kept to 1 m/s."""
    flown = flight()
    flown.fleet.reading("height_demand").add_(20.0)
    flown.fly(15.0, [0.0, 0.0, 0.0])
    assert flown.settles("height", HEIGHT + 20, 0.5, 7.0)
    assert flown.column("height").min() > HEIGHT - 0.01 and flown.column("height").max() < HEIGHT + 20.3
    assert flown.settles("airspeed", 25.0, 1.0, 0.0)


def test_climb_rate_is_as_demanded_and_then_the_height_is_held(flight):
    flown = flight().fly(10.0, [0.5, 0.0, 0.0])
    climb = 0.5 * flown.model.autopilot_limits.climb
    assert -flown.velocity[2] == pytest.approx(climb, rel=0.01)
    flown.fly(10.0, [0.0, 0.0, 0.0])
    assert flown.column("height")[-1] == pytest.approx(HEIGHT + 10 * climb, abs=0.3)


def test_airspeed_step(flight):
    """To the middle between cruise and the largest: within 0.3 m/s from 6 s on, and height kept to 0.3 m."""
    flown = flight().fly(15.0, [0.0, 0.0, 0.5])
    _, cruise, high = flown.model.limits.speeds
    assert flown.settles("airspeed", 0.5 * (cruise + high), 0.3, 6.0)
    assert flown.column("airspeed").max() < 0.5 * (cruise + high) + 0.7
    assert flown.settles("height", HEIGHT, 0.3, 0.0)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_steepest_turn_is_coordinated(flight, side):
    """Bank 45 deg, heading rate g tan(phi) / V and the smallest radius to 3 % (thrust carries some of the
    weight), sideslip below 0.5 deg, height to 1 m."""
    flown = flight().fly(8.0, [0.0, side, 0.0])
    psi = np.unwrap(flown.column("psi"))
    rate = (psi[-1] - psi[-21]) / 2.0
    assert flown.column("phi")[-1] == pytest.approx(side * math.radians(45), abs=0.01)
    assert rate == pytest.approx(side * GRAVITY / 25.0, rel=0.03)
    assert 25.0 / abs(rate) == pytest.approx(flown.model.limits.turn_radius, rel=0.03)
    assert np.abs(flown.column("beta")[-20:]).max() < math.radians(0.5)
    assert np.abs(flown.column("beta")).max() < math.radians(2.0)
    assert flown.settles("height", HEIGHT, 1.0, 0.0)


def test_pitch_is_as_demanded(flight):
    """sin theta above level flight's: 0.3 of that of max_pitch, 20 deg."""
    flown = flight("aerosonde", "guidance").fly(6.0, [0.3, 0.0, 0.0])
    wanted = math.sin(flown.model.cruise.theta) + 0.3 * math.sin(math.radians(20))
    assert flown.settles("theta", math.asin(wanted), math.radians(0.5), 3.0)


# -- envelope ----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_full_aft_stick_stalls_only_without_protection(flight):
    """The Zagi's: beyond the stall angle for seconds, or never."""
    free = flight("zagi", "surfaces", False).fly(10.0, [-1.0, 0.0, 0.0, 0.0])
    kept = flight("zagi", "surfaces", True).fly(10.0, [-1.0, 0.0, 0.0, 0.0])
    assert free.column("stall_time").max() > 1.0
    assert free.column("alpha").max() > free.model.stall_angles[1]
    assert kept.column("stall_time").max() == 0.0
    assert kept.column("alpha").max() < 0.9 * kept.model.stall_angles[1]


def test_stall_time_counts_and_starts_again(flight):
    flown = flight("zagi", "surfaces", False).fly(10.0, [-1.0, 0.0, 0.0, 0.0])
    beyond = flown.column("alpha") > flown.model.stall_angles[1]
    run = 0.0
    for stalled, told in zip(beyond, flown.column("stall_time"), strict=True):
        run = run + DT * SUBSTEPS if stalled else 0.0
        assert told == pytest.approx(run, abs=1e-9)
    assert beyond.any() and not beyond.all()


@pytest.mark.parametrize("demand", [[1.0, 0.0, -1.0], [1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]])
@pytest.mark.parametrize("name", ["aerosonde", "zagi"])
def test_no_demand_leaves_the_envelope(name, demand, flight):
    """Nose up at the least airspeed, the same in the steepest turn, nose down at the largest: no stall, load factor
    and bank within limits, no airspeed above the largest.
    """
    flown = flight(name, "guidance")
    flown.state[..., 2] = -1000.0
    flown.fly(20.0, demand)
    envelope = flown.model.p.envelope
    assert flown.column("stall_time").max() == 0.0
    assert flown.column("alpha").max() < 0.9 * flown.model.stall_angles[1]
    assert envelope.n_min < flown.column("load_factor").min() < flown.column("load_factor").max() < envelope.n_max
    assert np.abs(flown.column("phi")).max() < math.radians(60)
    assert flown.column("airspeed").max() < envelope.max_airspeed


# -- the other aircraft ------------------------------------------------------------------------------------------


def test_a_flying_wing_with_the_same_code(flight):
    """Zagi, no rudder: 30 deg within 2 deg from 8 s on, height kept to 0.5 m; 20 m within 0.5 m from 10 s on."""
    turned = flight("zagi").fly(15.0, to_course(math.radians(30)))
    assert turned.settles("course", math.radians(30), math.radians(2), 8.0)
    assert turned.settles("height", HEIGHT, 0.5, 0.0)
    climbed = flight("zagi")
    climbed.fleet.reading("height_demand").add_(20.0)
    climbed.fly(15.0, [0.0, 0.0, 0.0])
    assert climbed.settles("height", HEIGHT + 20, 0.5, 10.0)
    assert max(turned.column("stall_time").max(), climbed.column("stall_time").max()) == 0.0


# -- starts and refusals -----------------------------------------------------------------------------------------


def test_settled_starts_are_steady_in_any_wind(bench, aircraft):
    """A placed aircraft keeps position and heading, and flies at cruising airspeed, level, in a wind; its instruments
    show it from the beginning.
    """
    team, heading = bench(aircraft(), envs=2), np.array([0.7, -2.5])
    team.wind[:] = torch.tensor([[8.0, -3.0, 0.0], [-6.0, 12.0, 0.0]])
    placed = np.array([[[10.0, 20.0, -60.0]], [[-5.0, 3.0, -80.0]]])
    team.put(placed, np.stack([0 * heading, 0 * heading, heading], axis=-1)[:, None], settle=True)
    assert torch.equal(team.state[..., :3], torch.tensor(placed))
    shown = {name: team.fleet.reading(name).clone() for name in ("airspeed", "alpha", "beta", "wind_north")}
    team.step([0.0, 0.0, 0.0], times=30)
    assert torch.allclose(team.state[..., 2], torch.tensor(placed[..., 2]), atol=1e-3)
    for name, value in shown.items():
        assert torch.allclose(team.fleet.reading(name), value, atol=1e-3)
    assert torch.allclose(shown["airspeed"], torch.tensor(25.0, dtype=torch.float64), atol=1e-9)
    cosine, sine = team.fleet.heading
    assert torch.allclose(torch.atan2(sine, cosine)[:, 0], torch.tensor(heading), atol=1e-2)


@pytest.mark.parametrize(
    ("numbers", "told"),
    [
        ({"max_bank_deg": 78.0}, "max_bank_deg = 78: a level turn is 4.81 g, above n_max = 3.8"),
        ({"min_airspeed": 9.0}, "min_airspeed = 9: must lie between the stall at 11.3 m/s and cruise at 25 m/s"),
        ({"min_airspeed": 26.0}, "min_airspeed = 26"),
        ({"actions": "stick"}, "actions"),
    ],
)
def test_what_cannot_be_flown_is_refused(make_model, numbers, told):
    with pytest.raises(ConfigError, match=told):
        make_model("aerosonde", DT, SUBSTEPS, autopilot=numbers)
