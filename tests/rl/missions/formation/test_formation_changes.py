"""Formations that change during an episode: slots glide without a jump, keep apart, and begin where starts are."""

import itertools

import pytest
import torch
from small_missions import begin, everything, make, wander
from test_slots import DOUBLE, measured, target
from torch import Tensor

from rl.guidance.shapes import SHAPES, formation_offsets
from rl.guidance.targets_and_errors import GOAL
from rl.missions.formation.config import FormationTeam
from rl.missions.formation.slots import Drawn, Slots
from rl.perception.sensors import Sensor
from taichi_sim.kernels.conventions import STATE_SIZE

ALL = list(SHAPES)
CHANGING = (
    f"usv.formation.shapes={ALL}",
    "usv.formation.spacing_range=[10.0, 20.0]",
    "usv.formation.change_every=0.5",
    "usv.count=5",
)


def gliding(count: int, envs: int, *, interval: float, glide: float = 2.0, every: float = 1e3) -> Slots:
    """Slots of a team of any shape, whose first change is `every` s after the start."""
    formation = {"shapes": tuple(ALL), "spacing_range": (10.0, 20.0), "change_every": every}
    section = FormationTeam.model_validate({"vehicle": "any", "count": count, "formation": formation})
    state = torch.zeros((envs, count, STATE_SIZE), dtype=DOUBLE)
    slots = Slots(section, state, interval=interval, glide=glide, steps=round(4 * every / interval))
    generator = torch.Generator().manual_seed(3)
    pairs = torch.tensor(list(itertools.product(range(len(ALL)), repeat=2)))[torch.arange(envs) % len(ALL) ** 2]
    spacing = 10 + 10 * torch.rand((2, envs), generator=generator, dtype=DOUBLE)
    slots.begin(torch.arange(envs), Drawn(pairs[:, 0], spacing[0]), generator)
    slots._changes[:, 0] = torch.stack((pairs[:, 1].to(DOUBLE), spacing[1]), dim=-1)
    return slots


def after(slots: Slots, step: int) -> None:
    """Advance to the end of decision `step` of every environment's episode."""
    slots.advance(torch.full((len(slots.table),), step, dtype=torch.int64))


@pytest.mark.usefixtures("f64")
def test_slot_velocity_is_the_rate_of_the_slot_while_it_glides_and_the_course_turns():
    """Central differences over two decisions of 1 ms, of teams on a bend of 100 m at 12 m/s."""
    h, envs, turn = 1e-3, 36, 0.12
    slots = gliding(8, envs, interval=h, every=1.0)
    after(slots, 1000)
    seen = []
    for k in range(3):
        after(slots, 1001 + k)
        course = torch.linspace(-3, 3, envs, dtype=DOUBLE) + turn * h * k
        here = target(torch.zeros((envs, 3), dtype=DOUBLE), course, torch.full_like(course, turn), 12.0)
        velocity = torch.tensor([5.0, -3.0, 1.0], dtype=DOUBLE).expand(envs, 3)
        seen.append(measured(here, velocity * h * k, velocity, slots.table.clone()))
    rate = (seen[2].slot - seen[0].slot)[:, 1:] / (2 * h)
    assert (slots.rates.norm(dim=-1).amax(dim=1) > 1.99).sum() >= 30  # of the pairs of shapes, those that differ
    torch.testing.assert_close(seen[1].slot_velocity[:, 1:], rate, atol=1e-5, rtol=0)


@pytest.mark.usefixtures("f64")
@pytest.mark.parametrize("count", range(2, 17))
def test_slots_glide_to_the_new_formation_together_and_keep_apart(count):
    """From every shape to every other: |x| |g| / sqrt(x^2 + g^2) of two followers, which the spacings bound."""
    slots = gliding(count, 36, interval=0.1)
    first, last = slots.offsets.clone(), slots._changes[:, 0]
    spacing = (first[:, 1:] - first[:, :1]).norm(dim=-1).amin(dim=1), last[:, 1]
    bound = spacing[0] * spacing[1] / torch.hypot(*spacing)
    after(slots, 10000)
    assert slots.offsets.equal(first)  # nothing jumps
    glide, left = slots.rates.norm(dim=-1), slots._left.clone()
    assert glide.max() <= 2.0 + 1e-9
    for step in range(1, int(left.max() / 0.1) + 2):
        before = slots.offsets.clone()
        after(slots, 10000 + step)
        assert (slots.offsets - before).norm(dim=-1).max() <= 0.2 + 1e-9
        if count > 2:
            followers = slots.offsets[:, 1:]
            apart = torch.cdist(followers, followers) + 1e3 * torch.eye(count - 1, dtype=DOUBLE)
            assert (apart.amin(dim=(1, 2)) > bound - 1e-2).all()
    assert slots.offsets.equal(slots.table[..., GOAL:]) and not slots.rates.any()
    assert not slots.offsets[:, 0].any()
    for env, (shape, metres) in enumerate(last.tolist()):
        wanted = formation_offsets(ALL[int(shape)], count, metres)
        assert torch.cdist(wanted, slots.offsets[env]).amin(dim=1).max() < 1e-9  # every place has been taken


@pytest.mark.usefixtures("f64")
def test_a_change_while_slots_are_on_their_way_does_not_make_them_jump():
    slots = gliding(16, 36, interval=0.1, every=1.0)
    for step in range(1, 40):
        before = slots.offsets.clone()
        after(slots, step)
        assert (slots.offsets - before).norm(dim=-1).max() <= 0.2 + 1e-9


# -- in the mission ------------------------------------------------------------------------------------------------


def test_an_episode_begins_in_the_formation_that_its_start_was_drawn_with():
    task = make(*CHANGING, teams=("usv",), envs=16)
    team, formations = task.teams["usv"], task.starts.formations["usv"]
    assert formations.shape.unique().tolist() == list(range(len(ALL)))
    assert formations.spacing.min() >= 10.0 and formations.spacing.max() <= 20.0
    wander(task, 7)
    worlds, starts = torch.arange(4).repeat(2), torch.arange(8)
    task.reset(torch.arange(8), worlds=worlds, starts=starts)
    for env, (shape, spacing) in enumerate(zip(*formations.at(worlds, starts), strict=True)):
        wanted = formation_offsets(ALL[shape], 5, spacing).float()
        torch.testing.assert_close(team.offsets[env], wanted)
    assert not team.slots.rates[:8].any() and team.slots.rates[8:].any()


def test_changes_come_on_time_and_are_the_seeds():
    """Every half second of an episode, whatever happens to other environments; the policy is told."""
    task = make(*CHANGING, teams=("usv",))
    slots = task.teams["usv"].slots

    def future(reset: bool) -> list[dict[str, Tensor]]:
        begin(task, 3)
        wander(task, 2)
        if reset:
            task.reset(torch.tensor([1, 3]))
        seen = []
        for k in range(12):
            wander(task, 1, seed=k)
            seen.append(everything(task, [0, 2]))
        return seen

    for one, other in zip(future(False), future(True), strict=True):
        assert all(part.equal(other[key]) for key, part in one.items())
    begin(task, 3)
    changed = []
    for _ in range(11):
        goals = slots.table[..., GOAL:].clone()
        wander(task, 1)
        changed.append(bool((slots.table[..., GOAL:] != goals).any()))
    assert [k + 1 for k, change in enumerate(changed) if change] == [5, 10]


def test_a_formation_without_a_choice_is_never_advanced():
    task = make("usv.formation.change_every=0.1", teams=("usv",))
    before = task.teams["usv"].slots.table.clone()
    wander(task, 3)
    assert task.teams["usv"].slots.table.equal(before)
    assert not hasattr(task.teams["usv"].slots, "_launch")


@pytest.mark.parametrize("kind", ["paper", "full"])
def test_a_policy_of_three_fits_a_team_of_any_size(kind):
    """The same names, and so the same widths, in the same order; what is not there is out of range."""
    small = ("track.worlds=1", f"observations={kind}", "obstacles.count=4")
    names = []
    for count in (1, 3, 16):
        sizes = [f"{team}.{key}" for team in ("usv", "uav") for key in (f"count={count}", "formation=wedge")]
        task = make(*small, *sizes, envs=1)
        names.append({name: team.observation_names for name, team in task.teams.items()})
        assert all(team.observations().isfinite().all() for team in task.teams.values())
        if count == 1:
            mates = task.teams["usv"].sensor
            assert isinstance(mates, Sensor) and not mates.signals[..., -6:].any()
    assert names[0] == names[1] == names[2]
    assert ({"role", "offset.0", "encounters.17"} <= set(names[0]["usv"])) == (kind == "full")
