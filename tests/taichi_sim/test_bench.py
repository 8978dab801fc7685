"""The bench: what is put on it is read off it, and the numbers of a test travel with it."""

import numpy as np
import pytest
import torch

from taichi_sim.bench import Bench, pack_state
from taichi_sim.config import AirConfig, CurrentConfig, SeaConfig, WorldConfig
from taichi_sim.models.catalogue import load_vehicle
from taichi_sim.world import World

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


SERIES = "time,speed,direction_deg\n0,0.2,10\n1,0.4,80\n60,0.1,200\n"


@pytest.mark.parametrize(
    ("current", "air"),
    [
        ({"speed": 0.6, "direction_deg": 40.0, "std": 0.2, "time_constant": 2.0, "profile": "power"}, {"std": 0.5}),
        ({"series": "flow.csv"}, {"series": "flow.csv"}),
        ({"tide": {"constituents": {"M2": {"amplitude": 0.5}}}, "std": 0.1}, {"series": "flow.csv", "std": 0.3}),
    ],
)
def test_current_and_wind_are_those_of_a_world(tmp_path, monkeypatch, current, air):
    """Of one configuration and seed: what the vehicles are told, and how it moves them, after every step."""
    (tmp_path / "flow.csv").write_text(SERIES)
    current, air = (
        {key: str(tmp_path / value) if key == "series" else value for key, value in given.items()}
        for given in (current, air if "series" in air else air | {"speed": 6.0})
    )
    sea = SeaConfig(
        hs=0.3, tp=4.0, depth=5.0, realisations=2, components=4, current=CurrentConfig.model_validate(current)
    )
    config = WorldConfig.model_validate(
        {"seed": 7, "sea": sea, "air": AirConfig.model_validate(air), "boats": {"vehicle": "unity_boat", "count": 1}}
    )
    kind = type(load_vehicle("unity_boat", 0.02, 5))
    monkeypatch.setattr(kind, "draft", 0.8)
    monkeypatch.setattr(kind, "wind_height", 0.5)
    world = World(config, 3)
    bench = Bench("unity_boat", sea=sea, air=config.air, envs=3, substeps=5, seed=7).put(settle=True)
    world.place("boats", torch.arange(3), torch.zeros(3, 1, 13, dtype=torch.float64).index_fill(2, torch.tensor(3), 1))
    for step in range(12):
        bench.step(0.3)
        world.step({"boats": torch.as_tensor(bench.fleet.action)})
        felt, told = world.felt("boats"), bench.around
        assert bench.current.numpy() == pytest.approx(world.current.velocity.numpy(), abs=1e-12), step
        assert bench.wind.numpy() == pytest.approx(world.wind.velocity.numpy(), abs=1e-12), step
        assert bench.state.numpy() == pytest.approx(world.teams["boats"].state.numpy(), abs=1e-12), step
        bench.refresh()
        assert told.current.numpy() == pytest.approx(felt.current.numpy(), abs=1e-12)
        assert told.wind.numpy() == pytest.approx(felt.wind.numpy(), abs=1e-12)
    assert np.abs(bench.current.numpy()).max() > 0.1 and np.abs(bench.wind.numpy()).max() > 0.1


def test_a_steady_current_is_written_in_place_and_a_calm_bench_has_none():
    bench = Bench("unity_boat", envs=2)
    assert not bench.current.any() and not bench.wind.any()
    bench.current[1, 0] = 0.5
    bench.step(0.0, times=3)
    assert bench.around.current.tolist() == [[0.0, 0.0], [0.5, 0.0]]


def test_a_state_that_is_not_finite_is_told_once():
    bench = Bench("unity_boat", envs=3).step((0.5, 0.0))
    bench.state[1, 0, 7] = float("nan")
    with pytest.warns(RuntimeWarning, match="'fleet' is not finite .* in environment 1 ") as told:
        bench.step((0.5, 0.0)).step((0.5, 0.0))
    assert len(told) == 1
