"""Reward terms and observations that a scenario adds, changes and takes out, and classes of teams of one's own."""

import re

import pytest
import torch

from rl.learn.policy_interface import interface_of, told
from rl.missions import load_scenario, make_mission
from taichi_sim.config import ConfigError

MINE = '''
import torch
from rl.missions.escort.boats import EscortBoats
from rl.missions.escort.mission import Escort
from rl.missions.formation.mission import Formation
from rl.missions.formation.team import TeamTask
from rl.terms import Term


def calm(team, scale=1.0):
    """Minus the vertical speed over a scale (m/s): a quiet ride. Nothing else."""
    return -team.fleet.velocity_n[..., 2].abs() / scale


def wind(team):
    """Mean wind, north and east, over 20 m/s."""
    return team.mission.world.wind.velocity[:, None, :2].expand(*team.fleet.never.shape, 2) / 20.0


def flat(team):
    return team.fleet.velocity_n.sum()


def lost(team):
    return team.fleet.velocity_n[..., 2] * float("nan")


NUMBER = 3


class Mine(TeamTask):
    """Also calm; observes one thing more."""

    terms = {**TeamTask.terms, "calm": Term(calm, 0.5)}

    def observe(self):
        return {**super().observe(), "depth": self.fleet.position_n[..., 2:]}


class Quiet(Formation):
    Team = Mine


class Half(Formation):
    Teams = {"usv": Mine}


class Sums(TeamTask):
    def reward(self, ended):
        return -self.distance


class Summed(Formation):
    Team = Sums


class Nobody(Formation):
    Teams = {"ufo": Mine}


class Boats(EscortBoats):
    terms = {**EscortBoats.terms, "calm": Term(calm, 0.5)}


class Other(Escort):
    Teams = {"boats": Boats}
'''
FEW = ("track.worlds=2", "sea.realisations=2", "usv.count=2", "uav.count=1")


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "mine.py").write_text(MINE, encoding="utf-8")
    return tmp_path


@pytest.fixture
def made(folder):
    """Make a mission of a shipped scenario, copied into the folder with `end`, with changes."""

    def make(*overrides, end="", name="paper", mission=""):
        text = (load_file(name)).replace('name = "', f'mission = "{mission}"\nname = "' if mission else 'name = "', 1)
        (folder / "own.toml").write_text(text + end, encoding="utf-8")
        few = FEW if name == "paper" else ()
        config = load_scenario(folder / "own.toml", [*few, *overrides])
        return make_mission(config, 3, seed=1, source=folder / "own.toml")

    return make


def load_file(name):
    from taichi_sim.config.io import find_config

    text = find_config(name).read_text(encoding="utf-8")
    return re.sub(r"^mission = .*\n", "", text, flags=re.MULTILINE)


def stepped(mission, steps=3):
    for _ in range(steps):
        actions = {n: torch.full((3, t.fleet.count, len(t.action_names)), 0.3) for n, t in mission.teams.items()}
        step = mission.step(actions)
    return step


def test_a_term_is_added_another_is_changed_and_one_is_taken_out(made):
    plain, changed = made(), made(
        end='[usv.terms.calm]\nfunction = "mine:calm"\nweight = 0.2\nscale = 2.0\n'
            "[usv.terms.coarse]\nweight = 0.0\n[usv.terms.fine]\nscale = 3.0\n",
    )  # fmt: skip
    was, now = (stepped(mission).reward["usv"] for mission in (plain, changed))
    team = changed.teams["usv"]
    assert "coarse" in plain.teams["usv"].parts and "coarse" not in team.parts
    torch.testing.assert_close(team.parts["calm"], -0.1 * team.fleet.velocity_n[..., 2].abs())
    torch.testing.assert_close(team.parts["fine"], 1 / (1 + (team.distance / 3.0) ** 2))
    own = plain.teams["usv"].parts
    torch.testing.assert_close(now, was - own["coarse"] - own["fine"] + team.parts["fine"] + team.parts["calm"])
    logs = team.logs(team.ended())
    assert set(logs) <= set(team.all_logged)
    torch.testing.assert_close(logs["term.calm"], team.parts["calm"].mean())
    text = told("usv", interface_of(team))
    assert "weight 0.2, scale 2: Minus the vertical speed over a scale (m/s): a quiet ride" in text
    assert re.search(r"coarse +weight 0, scale 8", text)


def test_an_observation_is_added_and_others_are_left_out_in_their_order(made):
    plain, changed = made(), made(end='[usv.observe]\nwind = "mine:wind"\nwithout = ["drift", "role"]\n')
    was, now = (stepped(mission).observations["usv"] for mission in (plain, changed))
    before, after = (mission.teams["usv"].observation_names for mission in (plain, changed))
    kept = [k for k, name in enumerate(before) if name.partition(".")[0] not in ("drift", "role")]
    assert after == (*(before[k] for k in kept), "wind.0", "wind.1")
    assert now[..., :-2].equal(was[..., kept])
    assert now[..., -2:].equal(changed.world.wind.velocity[:, None, :2].expand(3, 2, 2) / 20.0)
    found = interface_of(changed.teams["usv"])["observations"]
    assert found["wind.1"] == "Mean wind, north and east, over 20 m/s"
    assert plain.teams["uav"].observation_names == changed.teams["uav"].observation_names


def test_the_scenarios_reward_chooses_weights_that_a_section_can_change(made):
    mission = made("reward=paper", "usv.terms.fine.weight=0.5")
    stepped(mission)
    assert list(mission.teams["uav"].parts) == ["paper", "collision"]
    assert list(mission.teams["usv"].parts) == ["fine", "paper", "collision"]


@pytest.mark.parametrize(
    ("end", "says"),
    [
        ('[usv.terms.calm]\nfunction = "mine:clam"\n', r"usv\.terms\.calm\.function = 'mine:clam': .*no 'clam'"),
        ('[usv.terms.calm]\nfunction = "yours:calm"\n', r"usv\.terms\.calm\.function = 'yours:calm': no module"),
        ('[usv.terms.calm]\nfunction = "mine:NUMBER"\n', r"function = 'mine:NUMBER': not a function"),
        ('[usv.terms.fine]\nfunction = "mine:calm"\n', r"usv\.terms\.fine\.function: the team has a term of this name"),
        ("[usv.terms.calm]\nweight = 1.0\n", r"usv\.terms\.calm = .*unknown key.*coarse"),
        ('[usv.terms.calm]\nfunction = "mine:calm"\nscal = 2.0\n', r"usv\.terms\.calm\.scal = 2\.0.*mean 'scale'"),
        ("[usv.terms.fine]\nscale = -1.0\n", r"usv\.terms\.fine\.scale = -1\.0: input should be greater than 0"),
        ("[usv.terms.fine]\nweight = inf\n", r"usv\.terms\.fine\.weight = inf"),
        ('[usv.terms.calm]\nfunction = "mine:flat"\n', r"usv\.terms\.calm: .*\[env, vehicle\] of 3 environments"),
        ('[usv.terms.calm]\nfunction = "mine:lost"\n', r"usv\.terms\.calm: it is not finite"),
        ('[usv.observe]\nwind = "mine:calm"\n', r"usv\.observe\.wind: .*\[env, vehicle, n\]"),
        ('[usv.observe]\nwind = "mine:gone"\n', r"usv\.observe\.wind = 'mine:gone'"),
        ('[usv.observe]\nrole = "mine:wind"\n', r"usv\.observe\.role: there is an observation of this name"),
        ('[usv.observe]\nwithout = ["rol"]\n', r"usv\.observe\.without: there is no 'rol', did you mean 'role'"),
        ('[usv.observe]\nwithout = ["role", "role"]\n', r"usv\.observe\.without: 'role' is named twice"),
        ("[stages.usv.set]\n'usv.terms.fin.weight' = 1.0\n", r"stages\.usv\.set: usv\.terms\.fin"),
    ],
)  # fmt: skip
def test_what_is_no_term_is_refused_with_file_and_key(made, end, says):
    with pytest.raises(ConfigError, match=says) as refused:
        made(end=end)
    assert "own.toml" in str(refused.value)


def test_a_class_of_ones_own_is_used_where_it_is_named(made):
    mission = made(mission="mine:Quiet")
    stepped(mission)
    assert [type(team).__name__ for team in mission.teams.values()] == ["Mine", "Mine"]
    assert all("calm" in team.parts and team.observation_names[-1] == "depth" for team in mission.teams.values())
    assert mission.teams["usv"].observations()[..., -1].equal(mission.teams["usv"].fleet.position_n[..., 2])
    half = made(mission="mine:Half")
    assert [type(team).__name__ for team in half.teams.values()] == ["Mine", "TeamTask"]
    assert type(mission.imagined(mission.teams["usv"]).teams["usv"]).__name__ == "Mine"


def test_a_class_of_boats_is_used_in_an_escort(made):
    mission = made(name="escort", mission="mine:Other")
    stepped(mission)
    assert [type(team).__name__ for team in mission.teams.values()] == ["Boats", "EscortAircraft"]
    assert "calm" in mission.teams["usv"].parts


def test_classes_that_no_team_has_are_refused(made):
    from rl.missions.escort.boats import EscortBoats
    from rl.missions.escort.mission import Escort
    from rl.missions.formation.mission import Formation

    with pytest.raises(ConfigError, match=r"Nobody\.Teams: .*no team 'ufo'"):
        made(mission="mine:Nobody")
    with pytest.raises(TypeError, match=r"Bad\.Team: Escort has no such team; `Teams` has 'boats', 'aircraft'"):
        type("Bad", (Escort,), {"Team": EscortBoats})
    with pytest.raises(TypeError, match=r"Bad\.Teams\['usv'\]: Escort has no such team"):
        type("Bad", (Escort,), {"Teams": {"usv": EscortBoats}})
    with pytest.raises(TypeError, match=r"Bad\.Team: EscortBoats must derive from rl\.missions\.formation\.team"):
        type("Bad", (Formation,), {"Team": EscortBoats})


def test_terms_of_a_team_that_sums_its_own_are_refused(made):
    assert made(mission="mine:Summed").teams["usv"].paid_by == {}
    with pytest.raises(ConfigError, match=r"usv\.terms: Sums\.reward does not use them"):
        made("usv.terms.fine.weight=2.0", mission="mine:Summed")
    with pytest.raises(ConfigError, match=r"usv\.terms: no policy acts for this team"):
        load_scenario("landing", ["usv.terms.fine.weight=2.0"])


def test_an_evaluation_refuses_them_too(folder):
    from rl.evaluation.episodes import one_episode_each

    config = load_scenario("paper", [*FEW, "usv.observe.without=['rol']"])
    with pytest.raises(ConfigError, match=r"usv\.observe\.without: there is no 'rol'"):
        one_episode_each(config, ("usv",), 2, 1, None)
