"""Motion is the integral of velocity, anywhere within 1,000 km of the origin and at any step.

f32 has 24 bits: 6 cm at 1,000 km, where a boat at 1 m/s moves by 0.25 mm in a step of 1/4000 s. Velocities do not
depend on the place, so a vehicle far away moves exactly as one at the origin does in calm water, and as far as the
trapezoidal sum of its velocities says.
"""

import numpy as np
import pytest
import torch

from taichi_sim.bench import Bench
from taichi_sim.kernels import runtime

PLACES = (0.0, 1e3, 1e6)  # m, north and (a third of it) east
SMALL = 1e-4  # relative error


def _moved(vehicle, rate, seconds, action, height=0.0, speed=1.0):
    """Ways [place, 3] of vehicles that begin at PLACES, and the trapezoidal sums of their velocities."""
    b = Bench(vehicle, dt=1 / rate, envs=len(PLACES))
    place = torch.tensor([[[x, -x / 3, -height]] for x in PLACES], dtype=torch.float64)
    b.put(place, velocity_b=(speed, 0.0, 0.0), settle=True)
    begin, seen = b.fleet.position_exact[:, 0].numpy(), []
    for _ in range(round(seconds * rate) + 1):
        seen.append(b.fleet.velocity_n[:, 0].double().numpy().copy())
        b.step(action)
    v = np.array(seen + [b.fleet.velocity_n[:, 0].double().numpy()])
    return b.fleet.position_exact[:, 0].numpy() - begin, (0.5 * (v[1:] + v[:-1])).sum(axis=0) / rate


def _agree(vehicle, rate, seconds, *flown):
    way, path = _moved(vehicle, rate, seconds, *flown)
    size = np.linalg.norm(path[:, :2], axis=1)
    assert (size > 0.5 * seconds).all()
    assert (np.linalg.norm((way - path)[:, :2], axis=1) < SMALL * size).all()
    assert np.allclose(way[:, :2], way[0, :2], atol=SMALL * size[0])


@pytest.mark.parametrize(
    ("vehicle", "action", "rate"),
    [("otter_3dof", (0.5, 0.1), 50), ("otter_3dof", (0.5, 0.1), 4000), ("cybership2", (0.5, 0.02), 400)],
)
def test_boats_move_by_the_integral_of_their_velocity(vehicle, action, rate):
    _agree(vehicle, rate, 0.5, action)


@pytest.mark.slow
def test_a_hull_moves_by_the_integral_of_its_velocity():
    _agree("otter", 1200, 0.2, (0.5, 0.05))


@pytest.mark.slow
def test_an_aircraft_moves_by_the_integral_of_its_velocity():
    _agree("aerosonde", 1200, 0.2, (0.0, 0.1, 0.0), 50.0, 25.0)


@pytest.mark.slow
@pytest.mark.parametrize("rate", [50, 400, 1200, 4000])
@pytest.mark.parametrize(
    ("vehicle", "action", "height", "speed"),
    [
        ("otter_3dof", (0.5, 0.1), 0.0, 1.0),
        ("kvlcc2", (0.5, 0.2), 0.0, 1.0),
        ("otter", (0.5, 0.05), 0.0, 1.0),
        ("wamv", (0.5, 0.05), 0.0, 1.0),
        ("aerosonde", (0.0, 0.1, 0.0), 50.0, 25.0),
        ("x500", (0.3, 0.1, 0.0, 0.0), 50.0, 2.0),
    ],
)
def test_all_move_by_the_integral_of_their_velocity(vehicle, action, height, speed, rate):
    _agree(vehicle, rate, 10.0, action, height, speed)


def test_a_place_written_by_hand_meets_no_older_remainder():
    """A remainder is at most half of the last digit of its position: another one counts as 0."""
    b = Bench("otter_3dof", dt=0.02)
    b.put((1e6, 0.0, 0.0), velocity_b=(1.0, 0.0, 0.0))
    b.step((0.5, 0.0), times=3)
    rest = float(b.fleet.remainder[0, 0, 0])
    assert 0.0 < abs(rest) <= 2**-5 and b.position[0] == float(b.state[0, 0, 0]) + rest
    b.state[0, 0, 0] = 10.0
    assert b.position[0] == 10.0
    b.step((0.5, 0.0))
    assert b.position[0] == pytest.approx(10.0 + 0.02, abs=2e-3)
    b.put((1e6, 0.0, 0.0))
    assert (b.fleet.remainder == 0.0).all()


def test_a_model_in_torch_moves_without_loss():
    b = Bench("otter_3dof", dt=0.02)
    b.put((1e6, -1e6, 0.0))
    for _ in range(1000):
        b.fleet.move(torch.tensor([2.5e-4, -1e-5, 0.0]))
    assert b.position == pytest.approx([1e6 + 0.25, -1e6 - 0.01, 0.0], abs=2e-6)


def test_in_double_precision_nothing_remains(f64):
    assert runtime.is_f64()
    b = Bench("otter_3dof", dt=0.02)
    b.put((1e6, 0.0, 0.0), velocity_b=(1.0, 0.0, 0.0))
    b.step((0.5, 0.0), times=5)
    assert (b.fleet.remainder == 0.0).all() and b.position[0] == float(b.state[0, 0, 0])
