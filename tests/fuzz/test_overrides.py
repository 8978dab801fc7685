"""Thousands of random overrides: each is refused by name, or makes a mission whose every output is finite."""

import numpy as np
import pytest
import torch

from rl.missions import load_scenario, make_mission
from rl.scenario import Scenario
from taichi_sim.applications.commands.trials import changes_of
from taichi_sim.config import ConfigError
from taichi_sim.errors import UserError
from taichi_sim.models.catalogue import load_vehicle, shipped_vehicles
from tests.fuzz.limits import within
from tests.fuzz.overrides import keys_of, overrides, scenario_keys

SCENARIOS = ("lanes", "cruise", "otter", "aerosonde", "escort", "landing")
SMALL = {"formation": ["track.worlds=2"], "escort": ["escort.worlds=2"], "landing": []}
OF_SCENARIO, OF_VEHICLES = 800, 1000  # overrides: 5,800 in all
RUN = 60  # accepted ones of each scenario that are run, too
LIMIT = 20  # s, for a scenario or a vehicle file to be read
COMPILED = 240  # s, for a mission whose kernels must be compiled, on a busy machine

pytestmark = pytest.mark.slow


def not_finite(config: Scenario) -> list[str]:
    """Outputs of two steps in two environments that are not finite."""
    mission, found = make_mission(config, 2, seed=1), []
    drawn = torch.Generator().manual_seed(1)

    def look(when: str, outputs: dict[str, torch.Tensor | None]) -> None:
        found.extend(f"{name} {when}" for name, x in outputs.items() if x is not None and not x.isfinite().all())

    for step in range(3):
        for name, team in mission.teams.items():
            look(f"of {name}, step {step}", {"observations": team.observations(), "truth": team.privileged,
                                             "state": team.fleet.state})  # fmt: skip
        if step == 2:
            break
        actions = {
            name: 2 * torch.rand(2, team.fleet.count, len(team.fleet.model.action_names), generator=drawn) - 1
            for name, team in mission.teams.items()
            if name not in config.scripted
        }
        done = mission.drive(actions)
        look(f"of step {step}", {f"reward of {name}": reward for name, reward in done.reward.items()})
    return found


@pytest.mark.parametrize("name", SCENARIOS)
def test_overrides_of_a_scenario_are_taken_or_refused_by_name(name):
    """800 of each of `SCENARIOS`; the first accepted ones are run for two steps."""
    shipped = load_scenario(name)
    keys, accepted, wrong = scenario_keys(shipped), 0, []
    small = ["sea.realisations=2", *SMALL[shipped.mission]]
    for number in range(OF_SCENARIO):
        given = overrides(keys, np.random.default_rng((SCENARIOS.index(name), number)))
        try:
            config = within(LIMIT, lambda given=given: load_scenario(name, given))
            accepted += 1
            if accepted <= RUN:
                config = load_scenario(name, given, small)
                if outputs := within(COMPILED, lambda config=config: not_finite(config)):
                    wrong.append(f"{number}: {given}: not finite: {', '.join(outputs)}")
        except UserError as error:
            assert str(error).strip()
        except Exception as error:
            wrong.append(f"{number}: {given}: {type(error).__name__}: {error}")
    assert not wrong, "\n".join(wrong)
    assert accepted > RUN


def test_overrides_of_a_vehicle_file_are_taken_or_refused_by_name():
    """1,000 over all shipped vehicles, as trials, SITL and fits take them."""
    files, wrong, accepted = shipped_vehicles(), [], 0
    keys = {file: keys_of(load_vehicle(file).params) for file in files}
    for number in range(OF_VEHICLES):
        file = files[number % len(files)]
        given = [text for text in overrides(keys[file], np.random.default_rng(number)) if text.partition("=")[1]]
        try:
            within(LIMIT, lambda file=file, given=given: load_vehicle(file, 0.02, 5, **changes_of(given)))
            accepted += 1
        except ConfigError as error:
            assert str(error).strip()
        except Exception as error:
            wrong.append(f"{number}: {file.stem}: {given}: {type(error).__name__}: {error}")
    assert not wrong, "\n".join(wrong)
    assert accepted > 100
