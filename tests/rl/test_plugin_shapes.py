"""What a team's class returns in a wrong shape or type is refused at the first step, by class, method and name."""

import pytest
import torch

from rl.mission import Mission, Team
from rl.missions import load_scenario

ENVS, VEHICLES = 3, 2


class Right(Team):
    """Everything as it should be."""

    def observe(self):
        return {"place": self.fleet.position_n}

    def reward(self, ended):
        return self.fleet.position_n[..., 0]

    def endings(self):
        return {"lost": self.fleet.position_n[..., 0] > 1e6}

    def info(self):
        return {"north": self.fleet.position_n[..., 0]}


class Anywhere(Mission):
    """Vehicles begin at the origin and do what they like."""

    def begin(self, envs):
        n = len(envs)
        self.place("usv", envs, torch.zeros(n, VEHICLES, 2), torch.zeros(n, VEHICLES))


def lived(kind):
    """A mission of such a team, one decision, all that it gives."""
    mission = type("Short", (Anywhere,), {"Team": kind})
    config = load_scenario("paper", (f"usv.count={VEHICLES}", "sea.realisations=2", "track.worlds=2"))
    task = mission(config, ENVS, seed=1, teams=["usv"])
    task.step({"usv": torch.zeros(ENVS, VEHICLES, 2)})
    team = task.teams["usv"]
    return team.observations(), team.infos()


def test_the_right_ones_are_taken():
    seen, told = lived(Right)
    assert seen.shape == (ENVS, VEHICLES, 3) and told["north"].shape == (ENVS, VEHICLES)


@pytest.mark.parametrize(
    ("method", "wrong", "told"),
    [
        ("reward", lambda right: right[:, 0], r"Wrong\.reward\(\) is torch\.float32 \[3\]"),
        ("reward", lambda right: right[:, :1], r"reward\(\) is torch\.float32 \[3, 1\]"),
        ("reward", lambda right: right > 0, r"reward\(\) is torch\.bool"),
        ("reward", lambda right: right.numpy(), r"reward\(\) is ndarray"),
        ("reward", lambda right: None, r"reward\(\) is NoneType"),
        ("endings", lambda right: {"lost": right["lost"].any(1, keepdim=True)}, r"endings\(\)\['lost'\]"),
        (
            "endings",
            lambda right: {"lost": right["lost"].float()},
            r"bool \[env, vehicle\] of 3 environments",
        ),
        ("observe", lambda right: {"place": right["place"][..., 0]}, r"observe\(\)\['place'\]"),
        ("info", lambda right: {"north": right["north"][:, 0]}, r"info\(\)\['north'\]"),
    ],
)
def test_the_wrong_ones_are_named(method, wrong, told):
    own = getattr(Right, method)
    kind = type("Wrong", (Right,), {method: lambda self, *given: wrong(own(self, *given))})
    with pytest.raises(TypeError, match=told):
        lived(kind)
