"""Numbers that are not finite, or absurd, anywhere in what a mission remembers: nobody else notices, nothing is left.

Some environments get a wrong number in a random tensor of their state, the others none. Everything that a mission gives
away must stay finite, the others must not differ by a bit, and after a reset the state must be finite.
"""

import math
import os

import numpy as np
import pytest
import torch
from folders import PLUGINS
from torch import Tensor

from rl.mission import Mission, Step
from rl.missions import load_scenario, make_mission
from taichi_sim.state.snapshot import Entry, walk

PLUGIN = PLUGINS / "buoys.toml"
SMALL = ("track.worlds=8", "sea.realisations=4")
SCENARIOS = {
    "lanes": SMALL,
    "otter": (*SMALL, "usv.formation.change_every=4", 'usv.formation.shapes=["abreast","wedge"]'),
    "aerosonde": SMALL,
    "escort": ("escort.worlds=8", "sea.realisations=4"),
    "landing": ("sea.realisations=4", "landing.distance=[2.0, 6.0]", "landing.height=[2.0, 4.0]"),
    "station": ("sea.realisations=4", "station.hold=31"),
    "encounter": ("sea.realisations=4",),
    str(PLUGIN): (),
}
WRONG = (math.nan, math.inf, -math.inf, 1e30, -1e30)
ENVS, HIT = 12, 6  # environments, and those that get a wrong number
WARM, STEPS, AFTER = 30, 3, 3  # decisions before the wrong numbers, with them, and after the reset of those hit
WRITES = int(os.environ.get("FUZZ_WRITES", 20000)) // len(SCENARIOS)  # for each scenario


def given_away(mission: Mission, step: Step) -> dict[str, Tensor]:
    """Everything that a learner, a judge or a recording takes from a step: name -> [env, ...]."""
    found = {"terminated": step.terminated.float(), "truncated": step.truncated.float()}
    for name, team in mission.teams.items():
        found[f"{name} reward"] = step.reward[name]
        found |= {f"{name} info {key}": value for key, value in team.infos().items()}
    return {key: value.clone() for key, value in found.items()}


def seen(mission: Mission) -> dict[str, Tensor]:
    """What the teams' policies and critics take next: name -> [env, vehicle, n]."""
    found = {}
    for name, team in mission.teams.items():
        found[f"{name} observed"] = team.observations()
        if (truth := team.privileged) is not None:
            found[f"{name} privileged"] = truth
    return found


def go(mission: Mission, steps: int, generator: torch.Generator, reset: bool = True) -> list[dict[str, Tensor]]:
    """Random small commands; environments that end begin anew."""
    found = []
    for _ in range(steps):
        actions = {}
        for name, team in mission.teams.items():
            shape = (mission.num_envs, team.fleet.count, len(team.action_names))
            actions[name] = 0.6 * torch.rand(shape, generator=generator) - 0.3
        step = mission.step(actions, begin=False)
        found.append(given_away(mission, step))
        if reset:
            mission.reset(step.over)
        logs = {
            f"{name} log {key}": value.reshape(1) for name, team in mission.teams.items()
            for key, value in team.log(step.endings[name]).items()
        }  # fmt: skip
        found[-1] |= seen(mission)
        found[-1] |= {f"log {key}": value.clone() for key, value in logs.items()}
    return found


def numbers(mission: Mission) -> list[Entry]:
    """What a wrong number can be written into."""
    entries = (entry for entry in walk(mission).entries if entry.of_env and isinstance(entry.value, Tensor))
    return [
        e for e in entries if e.value.is_floating_point() and len(e.value) == mission.num_envs and e.value[0].numel()
    ]


def fuzz(scenario: str, writes: int, seed: int) -> list[str]:
    """What went wrong, with what had been written."""
    source = PLUGIN if scenario == str(PLUGIN) else None
    mission = make_mission(load_scenario(scenario, SCENARIOS[scenario]), ENVS, seed=seed, source=source)
    draw, rng = torch.Generator().manual_seed(seed), np.random.default_rng(seed)
    go(mission, WARM, draw)
    begin, commands = mission.snapshot(), draw.get_state()
    right = go(mission, STEPS, draw)
    entries, wrong, hit = numbers(mission), [], torch.arange(HIT)
    mission.reset(hit)
    finite = {entry.path: bool(entry.value.isfinite().all()) for entry in entries}
    ended = torch.stack([(r["terminated"] + r["truncated"]) > 0 for r in right]).any(0)
    others = [e for e in range(HIT, ENVS) if not ended[e]]
    for _ in range(writes // HIT):
        mission.restore(begin)
        draw.set_state(commands)
        done = []
        for env in range(HIT):
            entry, value = entries[int(rng.integers(len(entries)))], float(rng.choice(WRONG))
            row = entry.value[env]
            at = tuple(int(rng.integers(n)) for n in row.shape)
            entry.value[(env, *at)] = value
            done.append(f"{entry.path}[{(env, *at)}] = {value:g}")
        try:
            found = go(mission, STEPS, draw)
            for k, (step, before) in enumerate(zip(found, right, strict=True)):
                for key, value in step.items():
                    bad = (~value.isfinite()).reshape(len(value), -1).any(1).nonzero().flatten().tolist()
                    if bad:
                        wrong.append(
                            f"step {k}: {key} of {bad} not finite: {[done[b] for b in bad if b < HIT] or done}"
                        )
                    if "log" not in key and not torch.equal(value[others], before[key][others]):
                        wrong.append(f"step {k}: {key} of others differs: {done}")
            mission.reset(hit)
            left = [e.path for e in entries if finite[e.path] and not e.value.isfinite().all()]
            if left:
                rows = {p: (~e.value.isfinite()).reshape(ENVS, -1).any(1).nonzero().flatten().tolist()
                        for e in entries for p in left if e.path == p}  # fmt: skip
                wrong.append(f"left after the reset: {rows}: {done}")
            for k, step in enumerate(go(mission, AFTER, draw)):
                for key, value in step.items():
                    if not value.isfinite().all():
                        wrong.append(f"after the reset, step {k}: {key} not finite: {done}")
        except Exception as error:  # noqa: BLE001
            wrong.append(f"{type(error).__name__} {error}: {done}")
        if len(wrong) > 40:
            break
    return [f"seed {seed}, {scenario}: {text}" for text in wrong]


@pytest.mark.slow
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_a_number_that_is_not_finite_stays_where_it_was_and_goes_with_its_episode(scenario):
    wrong = fuzz(scenario, WRITES, seed=1)
    assert not wrong, "\n".join(wrong[:20])
