"""docs/reference: every public name has its place, and every name on a page is there."""

import importlib
import re

from folders import ROOT

import rl
import taichi_sim as ts

PAGES = ROOT / "docs" / "reference"
NAMED = [name for page in PAGES.glob("*.md") for name in re.findall(r"^::: (\S+)$", page.read_text("utf-8"), re.M)]
OPTIONAL = ("rl.adapters.pettingzoo", "rl.adapters.sb3", "rl.adapters.skrl")  # need the extras marl, sb3, skrl


def test_every_public_name_is_on_a_page_once():
    public = sorted(re.sub(r"\.world\.replay$", ".replay", name) for name in NAMED if name.startswith("taichi_sim."))
    of_root = [name.partition(".")[2] for name in public if name.count(".") == 1]
    assert [name for name in of_root if name in ts.__all__] == ts.__all__
    assert len(set(NAMED)) == len(NAMED)


def test_every_name_of_rl_is_told_of():
    named = {name.rpartition(".")[2] for name in NAMED if name.startswith("rl.")}
    assert {*rl.__all__} - named == {"Endings", "Mission", "load_policy"}  # a contract's module shows the first two
    index = (PAGES / "index.md").read_text("utf-8")
    assert all(f"`{name}`" in index for name in rl.__all__)


def test_the_contracts_of_missions_are_there():
    contracts = {
        "rl.mission",
        "rl.team.Team",
        "rl.judge.Judge",
        "rl.scenario.Scenario",
        "rl.planning.planner.Planner",
    }
    assert contracts <= {*NAMED}


def test_named_things_are_there():
    for name in NAMED:
        if name.startswith(OPTIONAL):
            continue
        module, _, last = name.rpartition(".")
        try:
            importlib.import_module(name)
        except ModuleNotFoundError:
            assert hasattr(importlib.import_module(module), last), name
