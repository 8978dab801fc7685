"""What an evaluation measures, of episodes made by hand."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from rl.evaluation.intervals import intervals
from rl.judge import Judge
from rl.mission import Endings
from rl.missions.formation.judge import FormationJudge

STEPS, INTERVAL, SETTLE = 10, 0.1, 0.5  # s; measured from the sixth decision on
ENVS, VEHICLES = 3, 2
REWARD = torch.tensor([[1.0, 3.0], [5.0, 7.0], [-1.0, -1.0]])
DISTANCE = torch.tensor([[3.0, 4.0], [6.0, 1.0], [2.0, 0.5]])
GAP = torch.tensor([[9.0, 8.0], [-0.5, 8.0], [4.0, 2.0]])
SLOT_CLEARANCE = torch.ones(STEPS + 1, ENVS, VEHICLES)
SLOT_CLEARANCE[2:5, 0, 1] = SLOT_CLEARANCE[7, 0, 1] = SLOT_CLEARANCE[8:, 2, 0] = -1.0  # twice, and after its end
ACTIONS = torch.full((STEPS + 1, ENVS, VEHICLES, 2), 0.5)  # two actions, held; before the first decision there is none
ACTIONS[0] = 0.0
ACTIONS[1::2, 0, 0, 1] = -1.0  # one of the first environment goes from end to end every time
ACTIONS[2::2, 0, 0, 1] = 1.0
ACTIONS[8:, 2] = -1.0  # after its end
CONFIG = SimpleNamespace(
    decision_interval=INTERVAL, episode_steps=STEPS, evaluation=SimpleNamespace(settle=SETTLE, success_error=5.0)
)


def judged(patch: pytest.MonkeyPatch, kind: type[Judge], collides_at: int, lost_at: int) -> dict:
    """Figures of three environments: vehicle 0 of the second collides, vehicle 1 of the third is lost."""
    team = SimpleNamespace(fleet=SimpleNamespace(count=VEHICLES), distance=DISTANCE, sensor=SimpleNamespace(gap=GAP))
    team.now = SimpleNamespace(error=DISTANCE.unsqueeze(-1) * torch.tensor([0.6, 0.8, 0.0]))  # north-east
    team.target = SimpleNamespace(cos=torch.zeros(ENVS, 1), sin=torch.ones(ENVS, 1))  # goes east
    team.action = ACTIONS[0]
    clearance = iter(SLOT_CLEARANCE)
    mission = SimpleNamespace(num_envs=ENVS, teams={"boats": team}, config=CONFIG)
    patch.setattr("rl.missions.formation.judge.slot_clearance", lambda *_: next(clearance))
    judge = kind(mission, "boats")
    for number in range(1, STEPS + 1):
        ended = {name: torch.zeros((ENVS, VEHICLES), dtype=torch.bool) for name in ("collided", "lost")}
        team.previous_action, team.action = team.action, ACTIONS[number]
        ended["collided"][1, 0] = number >= collides_at
        ended["lost"][2, 1] = number >= lost_at
        judge.see(SimpleNamespace(reward={"boats": REWARD}, endings={"boats": Endings(ended)}), number)
    return kind.figures([judge], CONFIG)


def test_a_team_is_measured_until_one_of_it_has_ended(monkeypatch):
    """Ten decisions in the first environment, four in the second, seven in the third; one collision in them."""
    figures = judged(monkeypatch, Judge, 4, 7)
    assert set(figures) == set(Judge.definitions)
    assert figures["collisions_per_hour"] == pytest.approx(1 / ((10 + 4 + 7) * INTERVAL / 3600))
    assert figures["reward_per_step"] == pytest.approx((10 * 2.0 + 4 * 6.0 + 7 * -1.0) / (10 + 4 + 7))
    assert figures["collision_free_episodes"] == pytest.approx(2 / 3)


@pytest.mark.parametrize("kind", [Judge, FormationJudge])
def test_changes_of_actions_are_shares_of_their_range(monkeypatch, kind):
    """Of two vehicles' four actions one goes through its whole range, nine times in the first environment; none changes
    three times in the second and six times in the third."""
    figures = judged(monkeypatch, kind, 4, 7)
    assert figures["action_change_rms"] == pytest.approx((9 * 0.25 / (9 + 3 + 6)) ** 0.5)
    assert judged(monkeypatch, kind, 1, 1)["action_change_rms"] == pytest.approx(0.5)  # of the first alone


def test_an_evaluation_kept_from_before_actions_were_measured_is_read():
    numbers = dict.fromkeys(("collided", "failed", "succeeded", "reward", "decisions", "hours"), np.ones(4))
    assert intervals(Judge, numbers)["action_change_rms"] == (None, None, None)


def test_errors_of_a_formation_count_after_the_start_has_settled(monkeypatch):
    """Of the second environment none is left, of the third two; in all, seven leaders' and seven followers'."""
    figures = judged(monkeypatch, FormationJudge, 4, 7)
    assert set(figures) == set(FormationJudge.definitions)
    assert figures["leader_error_rms_m"] == pytest.approx(((5 * 9.0 + 2 * 4.0) / 7) ** 0.5)
    assert figures["cross_track_rms_m"] == pytest.approx(0.6 * figures["leader_error_rms_m"])
    assert figures["follower_error_rms_m"] == pytest.approx(((5 * 16.0 + 2 * 0.25) / 7) ** 0.5)
    assert figures["least_gap_m"] == pytest.approx((8.0 + 2.0) / 2)  # the second ended before it was measured
    assert figures["success_rate"] == pytest.approx(1 / 3)
    assert figures["evasions_per_hour"] == pytest.approx(2 / (2 * (10 + 4 + 7) * INTERVAL / 3600))


def test_errors_too_large_are_no_success(monkeypatch):
    """The second environment's leader is 6 m off throughout: a success needs less than 5 m."""
    figures = judged(monkeypatch, FormationJudge, STEPS + 1, STEPS + 1)
    assert figures["success_rate"] == pytest.approx(2 / 3) and figures["collisions_per_hour"] == 0.0


def test_a_line_to_read_says_what_was_not_measured(monkeypatch):
    figures = judged(monkeypatch, FormationJudge, 1, 1)
    nothing = figures | dict.fromkeys(("leader_error_rms_m", "follower_error_rms_m"))
    assert "leader error not measured, followers not measured" in FormationJudge.line(nothing)
    assert "reward_per_step" in Judge.line(judged(monkeypatch, Judge, 4, 7))
