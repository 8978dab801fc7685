"""Bootstrap intervals over episodes, against closed forms."""

import numpy as np
import pytest

from rl.evaluation.intervals import difference_of_shares, differences, intervals, ratios, wilson
from rl.judge import Judge
from rl.missions.formation.judge import FormationJudge


class Mean(Judge):
    """One figure, the mean of x."""

    shares = ("mean",)

    @classmethod
    def pooled(cls, episodes):
        return {"mean": episodes["x"].mean(-1)}


def test_the_interval_of_a_mean_is_that_of_the_central_limit_theorem():
    x = np.random.default_rng(1).normal(3.0, 2.0, 400)
    value, low, high = intervals(Mean, {"x": x})["mean"]
    half = 1.96 * x.std() / np.sqrt(len(x))
    assert value == pytest.approx(x.mean())
    assert (low, high) == pytest.approx((x.mean() - half, x.mean() + half), abs=0.06 * half)


def test_intervals_cover_the_truth_as_often_as_they_say():
    """Of 300 samples of a skewed law with mean 1, 95 % intervals of 100 episodes hold it in 91 to 97 %."""
    generator, held = np.random.default_rng(2), 0
    for _ in range(300):
        _, low, high = intervals(Mean, {"x": generator.exponential(1.0, 100)})["mean"]
        held += low <= 1.0 <= high
    assert 0.91 <= held / 300 <= 0.97


def test_what_makes_an_episode_hard_for_both_cancels_in_the_difference():
    generator = np.random.default_rng(3)
    hard, a, b = generator.normal(0.0, 10.0, 200), generator.normal(0.0, 0.1, 200), generator.normal(0.5, 0.1, 200)
    value, low, high = differences(Mean, {"x": hard + b}, {"x": hard + a})["mean"]
    assert value == pytest.approx(0.5, abs=0.03) and high - low < 0.06
    assert intervals(Mean, {"x": hard + b})["mean"].high > 1.0
    assert differences(Mean, {"x": hard}, {"x": hard})["mean"] == (0.0, 0.0, 0.0)


def test_what_makes_an_episode_hard_for_both_cancels_in_the_ratio():
    generator = np.random.default_rng(4)
    hard = generator.exponential(5.0, 200)
    value, low, high = ratios(Mean, {"x": 0.8 * hard + generator.normal(0.0, 0.1, 200)}, {"x": hard})["mean"]
    assert value == pytest.approx(0.8, abs=0.01) and high - low < 0.02
    assert ratios(Mean, {"x": hard}, {"x": 0.0 * hard})["mean"] == (None, None, None)


def test_the_same_episodes_by_several_policies_are_no_more_episodes():
    x = np.random.default_rng(5).normal(0.0, 1.0, 300)
    once = differences(Mean, {"x": x}, {"x": 0.0 * x})["mean"]
    thrice = differences(Mean, {"x": np.tile(x, 3)}, {"x": np.zeros(900)}, times=3)["mean"]
    assert thrice == pytest.approx(once)


@pytest.mark.parametrize(("hits", "of"), [(8, 8), (0, 8), (1, 1), (256, 256)])
def test_a_share_of_all_or_none_says_how_few_the_episodes_were(hits, of):
    """Wilson's interval of n of n reaches down to n / (n + z^2); a difference of two such shares has a width, too."""
    x, edge = np.repeat([1.0, 0.0], [hits, of - hits]), of / (of + 1.959964**2)
    low, high = (edge, 1.0) if hits else (0.0, 1 - edge)
    assert intervals(Mean, {"x": x})["mean"] == pytest.approx((hits / of, low, high))
    for times in (1, 3):  # more policies on the same episodes are no more episodes
        both = [{"x": np.tile(x, times)}, {"x": np.tile(x, times)}]
        assert differences(Mean, *both, times)["mean"] == pytest.approx((0.0, edge - 1, 1 - edge))
        assert ratios(Mean, *both, times)["mean"] == ((1.0, None, None) if hits else (None, None, None))


def test_intervals_of_shares_cover_the_truth_for_few_episodes():
    """Of 20 episodes, 90 % under one controller and 80 % under another, which fails mostly in the same."""
    generator, held = np.random.default_rng(6), np.zeros(2)
    for _ in range(2000):
        hard = generator.random(20)
        also = np.where(generator.random(20) < 0.8, hard, generator.random(20))
        one, other = (hard < 0.9).astype(float), (also < 0.8).astype(float)
        _, low, high = wilson(one)
        _, least, most = difference_of_shares(one, other)
        held += (low <= 0.9 <= high, least <= 0.1 <= most)
    assert ((held > 0.93 * 2000) & (held < 0.99 * 2000)).all(), held


def test_pairs_are_of_the_same_episodes():
    with pytest.raises(ValueError, match="3 and 4 episodes"):
        differences(Mean, {"x": np.zeros(3)}, {"x": np.zeros(4)})


def test_errors_are_pooled_over_time_and_an_episode_without_any_counts_for_nothing():
    """Root of the mean of squares: 10 s at 1 m and 30 s at 3 m make sqrt((10 + 270) / 40) m."""
    nothing = dict.fromkeys(("collided", "failed", "succeeded", "reward", "decisions"), np.zeros(3))
    episodes = nothing | {
        "hours": np.ones(3),
        "leader_error_rms_m": np.array([1.0, 3.0, np.nan]),
        "leader_s": np.array([10.0, 30.0, 0.0]),
        "follower_error_rms_m": np.full(3, np.nan),
        "follower_s": np.zeros(3),
        "least_gap_m": np.array([2.0, 5.0, np.nan]),
        "evasions": np.array([1.0, 2.0, 0.0]),
        "vehicle_hours": np.full(3, 2.0),
    }
    found = intervals(FormationJudge, episodes)
    assert found["evasions_per_hour"].value == pytest.approx(0.5)
    assert found["leader_error_rms_m"].value == pytest.approx(7.0**0.5)
    assert (found["leader_error_rms_m"].low, found["leader_error_rms_m"].high) == pytest.approx((1.0, 3.0))
    assert found["follower_error_rms_m"] == (None, None, None)
    assert found["least_gap_m"].value == pytest.approx(3.5)
