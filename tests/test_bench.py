"""The bench: what is put on it is read off it, and the numbers of a test travel with it."""

import numpy as np
import pytest

from taichi_sim.bench import Bench, pack_state

pytestmark = pytest.mark.usefixtures("f64")
RNG = np.random.default_rng(3)
ETA = np.hstack((RNG.uniform(-20, 20, (4, 3)), RNG.uniform(-1.4, 1.4, (4, 3))))
NU = RNG.uniform(-2, 2, (4, 6))


def test_what_is_put_is_read():
    bench = Bench("unity_boat", envs=4)
    bench.put(*(x[:, None] for x in (ETA[:, :3], ETA[:, 3:], NU[:, :3], NU[:, 3:])))
    for ours, given in zip(bench.read(), (ETA[:, :3], ETA[:, 3:], NU), strict=True):
        assert ours == pytest.approx(given, abs=1e-12)
    assert bench.state[:, 0].numpy() == pytest.approx(pack_state(ETA, NU), abs=1e-15)


def test_one_velocity_serves_all_poses():
    assert np.array_equal(pack_state(ETA, NU[0]), pack_state(ETA, np.tile(NU[0], (4, 1))))
    assert pack_state(np.zeros(6)).tolist() == [[0, 0, 0, 1] + [0] * 9]
