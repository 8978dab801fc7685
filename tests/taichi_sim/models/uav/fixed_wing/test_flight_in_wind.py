"""Aircraft in turbulence and gusts, through the kernel: what they feel, and what the autopilot makes of it."""

import dataclasses
import math

import numpy as np
import pytest
import torch

from taichi_sim.bench import Bench
from taichi_sim.config import AirConfig
from taichi_sim.kernels import runtime
from taichi_sim.kernels.conventions import GRAVITY

pytestmark = pytest.mark.slow

DT, SUBSTEPS = 0.02, 5
KNOT = 1852 / 3600  # m/s
W20, HEIGHT = 30 * KNOT, 50.0  # of the reference tables
MODERATE = {"speed": W20, "direction_deg": 90.0, "turbulence": "dryden", "turbulence_w20": W20}
FLIGHTS = 4000
LEVEL = (0.0, 0.0, 0.0)  # no climb, no turn, cruise
TOLD = {"f64": 1e-9, "f32": 1e-4}


class Flight(Bench):
    """`envs` aircraft, each alone in its own air, from cruise toward north."""

    def __init__(self, model, air, envs=1, height=HEIGHT, seed=5, clock=0):
        super().__init__(model, air=AirConfig(**air), envs=envs, seed=seed)
        self.around.noise.tick(clock)
        self.put((0.0, 0.0, -height), settle=True)

    def read(self, name):
        """A column of the auxiliary state [env], in double precision."""
        return self.fleet.reading(name)[:, 0].double()

    @property
    def height(self):
        """[env], m."""
        return -self.state[:, 0, 2].double()

    @property
    def heading(self):
        """[env], rad."""
        cosine, sine = self.fleet.heading
        return torch.atan2(sine[:, 0].double(), cosine[:, 0].double())

    def gusts(self):
        """Turbulence along the aircraft's mean path through the air (north), to its right and down [env, 3], m/s."""
        felt = torch.stack([self.read(name) for name in self.model.air], dim=1)
        return felt - self.wind.double()


@pytest.fixture(scope="module")
def model(precision, make_model):
    """An Aerosonde that holds its height."""
    return make_model("aerosonde", DT, SUBSTEPS, autopilot={"actions": "altitude"})


# -- what is felt ------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def felt(model):
    """Gusts of many flights [flight, 3]: in the first step, and 8, 9 and 10 s later."""
    flight = Flight(model, MODERATE | {"profile": "uniform"}, FLIGHTS)
    found = {}
    for step in range(101):
        flight.step(LEVEL)
        if step in (0, 80, 90, 100):
            found[step / 10] = flight.gusts()
    return found


@pytest.mark.parametrize("time", [0.0, 10.0])
def test_intensity_is_the_tables(time, felt, reference):
    """At 50 m in 30 kt, from the first step on: variances within 3 sampling errors, sqrt(2 / n). Means are zero at the
    start; later that along the path is -sigma^2 / V: who holds an airspeed stays longer in head winds.
    """
    rows = np.genfromtxt(reference / "dryden" / "dryden_discrete.csv", delimiter=",", names=True, deletechars="")
    row = next(r for r in rows if r["h_m"] == HEIGHT and r["W20_kt"] == 30)
    expected = torch.tensor([row["sigma_u^2"], row["sigma_u^2"], row["sigma_w^2"]], dtype=torch.float64)
    variance = (felt[time] ** 2).mean(dim=0)
    assert (variance / expected - 1).abs().max() < 3 * math.sqrt(2 / FLIGHTS)
    mean = torch.tensor([-float(expected[0]) / 25.0 if time else 0.0, 0.0, 0.0])
    assert ((felt[time].mean(dim=0) - mean).abs() < 3 * (expected / FLIGHTS).sqrt()).all()


def test_correlation_over_a_second_is_the_tables(felt, reference):
    """R(1 s) / sigma^2 of u, v, w, within 3 errors sqrt((1 + rho^2) / n)."""
    rows = np.genfromtxt(reference / "dryden" / "dryden_autocorrelation.csv", delimiter=",", names=True)
    at = {
        r["tau_s"]: np.array([r["R_u"], r["R_v"], r["R_w"]]) for r in rows if r["h_m"] == HEIGHT and r["W20_kt"] == 30
    }
    rho = torch.tensor(at[1.0] / at[0.0])
    ours = (felt[9.0] * felt[10.0]).mean(dim=0) / (felt[9.0] ** 2).mean(dim=0)
    assert ((ours - rho).abs() < 3 * ((1 + rho**2) / FLIGHTS).sqrt()).all()


def test_the_mean_wind_is_that_of_the_height(model):
    """The log profile of Charnock's sea: 30 m over 10 m; and W20 that of the mean wind where none is given."""
    flight = Flight(model, {"speed": 12.0, "turbulence": "dryden"}, FLIGHTS, height=30.0).step(LEVEL)
    expected = 12.0 * flight.around.air.speed_factor(30.0)
    assert float(flight.read("wind_north").mean()) == pytest.approx(-expected, abs=3 * 2.0 / math.sqrt(FLIGHTS))
    sigma = 0.1 * 12.0 * flight.around.air.w20_factor
    assert float(flight.read("wind_down").std()) == pytest.approx(sigma, rel=3 / math.sqrt(2 * FLIGHTS))


def test_turbulence_may_differ_in_intensity_from_environment_to_environment(make_model):
    """The same gusts, in the first step, times each environment's factor."""
    model = make_model("aerosonde", DT, SUBSTEPS, autopilot={"actions": "altitude"})
    factor = torch.tensor([0.5, 1.0, 2.0, 0.0])
    even, uneven = (Flight(model, MODERATE | {"profile": "uniform"}, 4) for _ in range(2))
    uneven.around = dataclasses.replace(uneven.around, turbulence=factor)
    one, own = (flight.step(LEVEL).gusts() for flight in (even, uneven))
    assert one.abs().min() > 0.01
    assert own.numpy() == pytest.approx((factor[:, None] * one).numpy(), abs=1e-4)


def test_noise_is_that_of_seed_env_and_time(model):
    """The same seed and clock repeat the flight to the bit; another seed, environment or clock does not."""
    air = MODERATE | {"profile": "uniform"}
    first, again = Flight(model, air, 4), Flight(model, air, 4)
    other, later = Flight(model, air, 4, seed=6), Flight(model, air, 4, clock=1000)
    for flight in (first, again, other, later):
        flight.step(LEVEL, 5)
    assert torch.equal(first.state, again.state) and torch.equal(first.aux, again.aux)
    down = [first.read("wind_down"), other.read("wind_down"), later.read("wind_down")]
    assert len({round(float(x), 6) for tensor in down for x in tensor}) == 12


# -- what the autopilot makes of it ------------------------------------------------------------------------------


@pytest.mark.parametrize("what", ["turn", "climb"])
def test_steps_in_moderate_turbulence(what, model):
    """30 deg to the right, and 20 m up, in 30 kt with turbulence, 100 flights: from 5 s (8 s) on the errors' standard
    deviation is below 2 deg and 1 m, none is above 10 deg or 4 m; no height lost above 5 m, no stall.
    """
    flight = Flight(model, MODERATE, 100).step(LEVEL)
    wanted, rise, start = (math.radians(30), 0.0, 50) if what == "turn" else (0.0, 20.0, 80)
    flight.fleet.reading("height_demand").add_(rise)
    headings, heights, stalls = [], [], []
    action = torch.zeros((100, 1, 3), dtype=torch.float64)
    for _ in range(200):
        action[:, 0, 1] = model.turn(wanted - flight.heading, flight.read("airspeed"))
        flight.step(action)
        headings.append(torch.rad2deg(flight.heading - wanted))
        heights.append(flight.height - HEIGHT)
        stalls.append(flight.read("stall_time"))
    headings, heights = torch.stack(headings), torch.stack(heights)
    assert headings[start:].std() < 2.0 and headings[start:].abs().max() < 10.0
    assert abs(float(headings[start:].mean())) < 0.5
    assert (heights[start:] - rise).std() < 1.0 and (heights[start:] - rise).abs().max() < 4.0
    assert heights.min() > -5.0
    assert torch.stack(stalls).max() == 0.0


def test_no_stall_at_the_least_airspeed_in_turbulence(model):
    """The envelope: at boost -1 in moderate turbulence, 300 flights of 20 s."""
    flight = Flight(model, MODERATE, 300, height=100.0)
    worst = 0.0
    for _ in range(200):
        flight.step([0.0, 0.0, -1.0])
        worst = max(worst, float(flight.read("stall_time").max()))
    assert worst == 0.0
    assert float(flight.read("airspeed").mean()) == pytest.approx(model.limits.speeds[0], abs=0.5)


def test_steady_wind_is_nothing_to_the_flight(model, precision):
    """Uniform profile: attitude, rates and air data as in still air, whatever the autopilot does."""
    still = Flight(model, {})
    windy = Flight(model, {"speed": 14.0, "direction_deg": 250.0, "profile": "uniform"})
    for step in range(60):
        action = [0.5 * math.sin(0.2 * step), math.cos(0.1 * step), math.sin(0.05 * step)]
        still.step(action)
        windy.step(action)
    told = TOLD[precision]
    assert torch.allclose(windy.state[..., 3:7], still.state[..., 3:7], atol=told, rtol=0)
    assert torch.allclose(windy.state[..., 10:], still.state[..., 10:], atol=10 * told, rtol=0)
    assert torch.allclose(windy.aux[..., :8], still.aux[..., :8], atol=100 * told, rtol=0)
    assert float(still.read("alpha").abs().max()) > 0.01 and float(still.state[..., 10:].abs().max()) > 0.01


def test_nan_in_one_aircraft_leaves_its_neighbours_bits(model):
    healthy, sick = (Flight(model, MODERATE | {"profile": "uniform"}, 3) for _ in range(2))
    sick.state[1, 0, 8] = math.nan
    for flight in (healthy, sick):
        flight.step([0.2, 0.5, 0.3], 5)
    assert torch.isnan(sick.state[1]).any()
    for ours, theirs in ((sick.state, healthy.state), (sick.aux, healthy.aux)):
        assert torch.equal(ours[[0, 2]], theirs[[0, 2]])


# -- a discrete gust ---------------------------------------------------------------------------------------------


def test_load_factor_of_a_rising_gust(precision, make_model):
    """An upward 1 - cosine gust of 3 m/s, reached in 0.06 s, controls fixed: n grows by K (U(t) - v), K = rho V S
    C_L_alpha / (2 m g), where v is the wing's own rise, v' = K g (U - v), in closed form. Within 15 %: pitching and
    q's lift are not in it.
    """
    T, U, dt = 0.06, 3.0, 0.01
    fixed = make_model("aerosonde", dt, 1, autopilot={"actions": "surfaces", "protection": False})
    gust = {"amplitude": (0.0, 0.0, -U), "shape": "ramp", "start_time": 0.0, "rise_time": T}
    flight = Flight(fixed, {"gust": gust, "profile": "uniform"})
    n = []
    for _ in range(6):
        flight.step([0.0] * 4)
        n.append(float(flight.read("load_factor")[0]))
    p, g = fixed.p, GRAVITY
    K = p.physical.rho * 25.0 * p.physical.S * p.longitudinal.C_L_alpha / (2 * p.physical.mass * g)
    t, Z, w = dt * np.arange(1, 7), K * g, math.pi / T
    rise = 1 - (Z**2 * np.cos(w * t) + Z * w * np.sin(w * t) + w**2 * np.exp(-Z * t)) / (Z**2 + w**2)
    expected = K * (U * 0.5 * (1 - np.cos(w * t)) - 0.5 * U * rise)
    assert np.array(n[2:]) - math.cos(fixed.cruise.theta) == pytest.approx(expected[2:], rel=0.15)


def _through(gust, dt, make_model):
    """Pitch (deg) every 0.1 s through a gust, surfaces held, by steps of dt (s), and the place [3] (m) after 10 s."""
    substeps = round(0.1 / dt)
    fixed = make_model("aerosonde", dt, substeps, autopilot={"actions": "surfaces", "protection": False})
    flight = Flight(fixed, {"gust": {"amplitude": (0.0, 1.0, -3.0)} | gust, "profile": "uniform"})
    pitch = []
    for _ in range(15):
        flight.step([0.0] * 4)
        pitch.append(flight.euler[1])
    return np.rad2deg(pitch), flight.step([0.0] * 4, 85).position


@pytest.mark.usefixtures("f64")
@pytest.mark.parametrize(
    "gust",
    [
        pytest.param({"start_time": 0.3, "rise_time": 0.5}, marks=pytest.mark.slow),
        {"start_north": 7.5, "start_east": 0.0, "direction_deg": 0.0, "length": 12.5},
    ],
    ids=["of a time", "at a place"],
)
def test_a_gust_of_a_second_is_met_to_second_order(gust, make_model):
    """Against an eighth of the step: 0.005 deg of pitch at 0.02 s, and the quarter at half the step,
    (8^2 - 1) / (4^2 - 1) = 4.2 of what is left. Met half a step late it was 0.2 deg, and the half.
    """
    flights = [_through(gust, dt, make_model) for dt in (0.02, 0.01, 0.0025)]
    coarse, half, fine = (pitch for pitch, _ in flights)
    off, off_half = (np.linalg.norm(place - flights[2][1]) for _, place in flights[:2])
    assert off < 2e-3 and off / off_half == pytest.approx(63 / 15, rel=0.05)  # 2 mm after 10 s
    assert np.ptp(fine) > 3.0
    error, of_half = (np.abs(x - fine).max() for x in (coarse, half))
    assert error < 0.005
    assert error / of_half == pytest.approx(63 / 15, rel=0.05)


# -- threads -----------------------------------------------------------------------------------------------------


def test_bits_do_not_depend_on_the_number_of_threads(make_model):
    """64 flights in turbulence: the same state and air from one thread and from two."""
    found = []
    for threads in (1, 2):
        runtime.init(precision="f32", threads=threads)
        own = make_model("aerosonde", DT, SUBSTEPS, autopilot={"actions": "altitude"})
        flight = Flight(own, MODERATE, 64)
        flight.step([0.3, 0.5, -0.5], 10)
        found.append((flight.state, flight.aux))
    assert torch.equal(found[0][0], found[1][0]) and torch.equal(found[0][1], found[1][1])
