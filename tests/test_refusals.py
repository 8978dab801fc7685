"""Checks belong to the doors (CONTRIBUTING.md): their number does not grow, and commands print what they refuse."""

import re
from collections import Counter

from folders import ROOT

RAISE = re.compile(r"^\s*raise\b", re.MULTILINE)
MOST = {
    "rl": 24,
    "rl/adapters": 21,
    "rl/commands": 27,
    "rl/evaluation": 28,
    "rl/guidance": 11,
    "rl/learn": 34,
    "rl/missions": 32,
    "rl/planning": 3,
    "rl/runs": 26,
    "taichi_sim": 31,
    "taichi_sim/applications": 90,
    "taichi_sim/config": 39,
    "taichi_sim/kernels": 13,
    "taichi_sim/models": 34,
    "taichi_sim/randomisation": 2,
    "taichi_sim/state": 17,
    "taichi_sim/surroundings": 36,
    "taichi_sim/visualisation": 35,
    "tools": 40,
}
"""Folder -> its `raise` statements; lower a number with each that goes."""
INNER = {"PacketError": "a packet is dropped, and counted", "_HappenedError": "ends a loop"}
"""Errors that no user sees, and why."""


def sources():
    """Folder and text of every file of the three packages."""
    for package in ("taichi_sim", "rl", "tools"):
        for file in sorted((ROOT / package).rglob("*.py")):
            parts = file.relative_to(ROOT).parts
            yield "/".join(parts[:2] if package != "tools" and len(parts) > 2 else parts[:1]), file.read_text("utf-8")


def test_no_folder_refuses_in_more_places():
    found = Counter()
    for folder, text in sources():
        found[folder] += len(RAISE.findall(text))
    grown = {folder: (count, MOST.get(folder, 0)) for folder, count in found.items() if count > MOST.get(folder, 0)}
    assert not grown, f"folder: (raise statements, allowed): {grown}; a new refusal belongs to a door (CONTRIBUTING.md)"


def test_errors_are_those_of_users():
    bases = {}
    for _, text in sources():
        bases |= dict(re.findall(r"^class (\w+Error)\((?!NamedTuple)(.*)\):", text, re.MULTILINE))

    def of_users(name: str) -> bool:
        return name == "UserError" or any(of_users(base) for base in bases.get(name, "").split(", ") if base)

    assert {name for name in bases if not of_users(name)} == set(INNER)
