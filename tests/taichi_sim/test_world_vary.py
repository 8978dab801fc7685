"""Worlds that vary: who gets what, when, and that it reaches the physics."""

import numpy as np
import pytest
import torch

from taichi_sim.config import ConfigError
from taichi_sim.state.divergence_dump import load_dump
from taichi_sim.world import World, replay

SMALL = ("sea.realisations=4", "sea.components=4", "usv.count=2", "uav.count=1")
CONDITIONS = (
    "vary.sea.hs=[0.1, 0.6]", "vary.sea.current.speed=[0.1, 1]", "vary.sea.current.direction_deg=[0, 360]",
    "vary.air.speed=[1, 9]", "vary.air.direction_deg=[0, 360]", "vary.air.turbulence=[0.5, 1.5]",
)  # fmt: skip
NUMBERS = ("usv.vary.mass={factor=[0.5, 2]}", "usv.vary.drag={add=[0, 0.4]}")
ENVS = 6


def make(*overrides, teams=("usv",), **options):
    return World.from_scenario("paper", ENVS, overrides=(*SMALL, *overrides), teams=teams, **options)


def drive(world, steps=3):
    for _ in range(steps):
        world.step({n: torch.full((ENVS, f.count, len(f.model.action_names)), 0.5) for n, f in world.teams.items()})
    return world


def whole(world):
    """All that differs between environments."""
    tables = {"current": world.around.current, "wind": world.around.wind}
    for name, fleet in world.teams.items():
        tables |= {f"{name} truth": world.truth[name], **{f"{name} {key}": x for key, x in fleet.vary.items()}}
    return {key: table.clone() for key, table in tables.items()}


@pytest.fixture
def varied():
    return make(*CONDITIONS, *NUMBERS, "sea.current.std=0.1", "air.std=0.5")


def test_no_variation_is_the_world_without_ranges_to_the_bit():
    slow = ("sea.current.std=0.1", "air.std=0.5")
    plain, still = make(*slow), make(*slow, *CONDITIONS, *NUMBERS, "variation=0")
    for world in (plain, still):
        drive(world)
        world.renew(torch.tensor([1, 4]))
        drive(world)
    fleet = still.teams["usv"]
    assert fleet.state.equal(plain.teams["usv"].state) and not fleet.varied
    assert still.around.wind.equal(plain.around.wind) and still.sea.table.equal(plain.sea.table)
    assert still.around.turbulence is None


def test_an_episode_has_the_conditions_of_its_sea_and_numbers_of_its_own(varied):
    found, seas = varied.conditions, torch.tensor([3, 1])
    envs = torch.tensor([4, 0])
    before = whole(varied)
    varied.env_sea[envs] = seas.to(torch.int32)
    varied.renew(envs)
    after = whole(varied)
    others = [1, 2, 3, 5]
    for key in ("current", "wind", "usv truth", "usv mass", "usv drag"):
        assert after[key][others].equal(before[key][others]), key
        assert not torch.isclose(after[key][envs], before[key][envs]).all(), key
    assert varied.around.turbulence is not None
    assert varied.around.turbulence[envs].numpy() == pytest.approx(found.turbulence[seas])
    still = make(*CONDITIONS, *NUMBERS)  # the same realisations, without slow variations
    speed = still.around.current.norm(dim=1).numpy()
    assert speed == pytest.approx(still.conditions.current_speed[np.arange(ENVS) % 4], rel=1e-6)
    assert still.around.wind.norm(dim=1).numpy() == pytest.approx(found.wind_speed[np.arange(ENVS) % 4], rel=1e-6)


def test_slow_variations_are_about_the_realisation_s_own_means():
    world = make(
        *CONDITIONS, "sea.current.std=0.05", "sea.current.time_constant=0.5", "air.std=0.2", "air.time_constant=0.5"
    )
    records = {"current": [], "wind": []}
    for _ in range(400):
        world.current.advance(1.0)
        world.wind.advance(1.0)
        records["current"].append(world.current.velocity.clone())
        records["wind"].append(world.wind.velocity[:, :2].clone())
    tables = world.conditions.tables()
    of_envs = world.env_sea.long()
    assert torch.stack(records["current"]).mean(0).numpy() == pytest.approx(tables.current[of_envs].numpy(), abs=0.02)
    assert torch.stack(records["wind"]).mean(0).numpy() == pytest.approx(tables.wind[of_envs, :2].numpy(), abs=0.1)


def test_truth_is_what_was_drawn_and_as_wide_whatever_the_variation(varied):
    fleet, names = varied.teams["usv"], varied.truth_names["usv"]
    truth = dict(zip(names, varied.truth["usv"].unbind(-1), strict=True))
    assert names[:3] == ("mass", "drag", "sea.hs") and varied.truth["usv"].shape == (ENVS, 2, len(names))
    nominal = fleet.model.nominal
    for key in ("mass", "drag"):
        assert truth[key].double() == pytest.approx(fleet.vary[key] / nominal[key] - 1, abs=1e-6)
        assert truth[key].unique().numel() == ENVS * 2
    assert truth["sea.hs"][:, 1].numpy() == pytest.approx(varied.conditions.hs[varied.env_sea])
    still = make(*CONDITIONS, *NUMBERS, "variation=0")
    assert still.truth_names == varied.truth_names and still.truth["usv"].shape == varied.truth["usv"].shape
    assert bool((still.truth["usv"] == still.truth["usv"][0, 0]).all()) and not still.truth["usv"][..., :2].any()


def test_numbers_fill_their_ranges_evenly(varied):
    found = []
    for _ in range(200):
        varied.renew(torch.arange(ENVS))
        found.append(torch.stack(list(varied.teams["usv"].vary.values())).flatten(1))
    values = dict(zip(varied.teams["usv"].model.varying, torch.cat(found, 1).sort(dim=1).values, strict=True))
    for key, low, high in (("mass", 25.0, 100.0), ("drag", 1.0, 1.4)):
        n = values[key].numel()
        nominal = varied.teams["usv"].model.nominal[key]
        low, high = (0.5 * nominal, 2 * nominal) if key == "mass" else (nominal, nominal + 0.4)
        even = low + (high - low) * (torch.arange(n) + 0.5) / n
        assert float((values[key] - even).abs().max() / (high - low)) < 1.95 / n**0.5, key


def test_the_same_seed_draws_the_same_and_another_does_not(varied):
    def later(world, seed):
        world.reseed(seed)
        world.renew(torch.arange(ENVS))
        drive(world)
        return whole(world)

    again = make(*CONDITIONS, *NUMBERS, "sea.current.std=0.1", "air.std=0.5")
    assert all(again_.equal(first) for again_, first in zip(whole(again).values(), whole(varied).values(), strict=True))
    drive(varied, 2)
    first, second, other = later(varied, 5), later(again, 5), later(varied, 6)
    for key in first:
        assert first[key].equal(second[key]), key
    for key in ("current", "wind", "usv mass"):
        assert not first[key].equal(other[key]), key


def test_a_heavier_boat_gathers_way_more_slowly():
    """From rest in calm water, before drag counts: mass times speed is the same for all."""
    world = make("usv.vary.mass={factor=[0.5, 2]}", "sea.hs=0", "sea.tp=4", "decision_interval=0.02")
    fleet = world.teams["usv"]
    world.place("usv", torch.arange(ENVS), fleet.state.clone())
    world.step({"usv": torch.ones((ENVS, 2, 2))})
    impulse = fleet.vary["mass"] * fleet.velocity_b[..., 0]
    assert fleet.velocity_b[..., 0].max() > 1.2 * fleet.velocity_b[..., 0].min()
    assert impulse.numpy() == pytest.approx(impulse.mean().item(), rel=0.02)


def test_a_dump_of_a_varied_environment_runs_again(varied, tmp_path):
    varied.dump_folder = tmp_path
    varied.env_sea[:] = 2
    varied.renew(torch.arange(ENVS))
    drive(varied)
    fleet = varied.teams["usv"]
    fleet.state[3, 0, 7] = 1e38
    drive(varied, 1)
    (file,) = tmp_path.glob("*.dump")
    again = replay(load_dump(file))
    assert again.teams["usv"].state[0, 1].equal(fleet.state[3, 1])
    assert again.truth["usv"][0, :, 2:].equal(varied.truth["usv"][3, :, 2:])


@pytest.mark.parametrize(
    ("override", "told"),
    [
        ("usv.vary.mas={factor=[1, 2]}", "usv.vary.mas = .* 'mas' cannot vary, did you mean 'mass'"),
        ("usv.vary.mass=[-1, 50]", "usv.vary.mass = .*: -1 cannot be: Input should be greater than 0"),
    ],
)
@pytest.mark.parametrize("variation", [0, 2])
def test_numbers_that_cannot_be_are_refused_where_the_scenario_gives_them(override, told, variation):
    with pytest.raises(ConfigError, match=told):
        make(override, f"variation={variation}")


def test_numbers_that_only_a_wider_variation_makes_impossible_are_moved_back():
    world = make("usv.vary.drag={factor=[0.3, 1]}", "variation=2")  # down to -0.4
    drag, most = world.teams["usv"].vary["drag"], world.teams["usv"].model.nominal["drag"]
    assert 0.0 <= drag.min() < 0.5 * most < drag.max() < most
