"""Imports point one way: a module may import from its own layer and from those below it, never from above."""

import ast
from collections.abc import Iterator
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest
from folders import ROOT

COMMANDS = ("rl.train", *(f"rl.commands.{name}" for name in (
    "evaluate", "tune", "play", "report", "score", "describe", "export", "pilot",
)))  # fmt: skip

# From the bottom up; a name stands for the module or package and all inside it.
LAYERS = (
    ("taichi_sim.errors", "taichi_sim.options"),
    (
        "taichi_sim.config",
        "taichi_sim.kernels",
        "taichi_sim.state.memory",
        "taichi_sim.visualisation.plotting",
        "taichi_sim.state.snapshot",
    ),
    ("taichi_sim.surroundings.sea", "taichi_sim.surroundings.air"),
    (
        "taichi_sim.surroundings.around_vehicles",
        "taichi_sim.models.contact.deck_and_legs",
        "taichi_sim.models.contact.deck_motion",
        "taichi_sim.models.contact.leg_contact",
    ),
    ("taichi_sim.fleet",),
    ("taichi_sim.vehicle",),
    ("taichi_sim.models.contact",),
    ("taichi_sim.models.usv", "taichi_sim.models.uav"),
    ("taichi_sim.models.catalogue",),
    ("taichi_sim.state.divergence_dump",),
    ("taichi_sim.randomisation",),
    ("taichi_sim.world",),
    ("taichi_sim.state.divergence",),
    ("taichi_sim.bench", "taichi_sim.visualisation.recording", "taichi_sim.applications.hydro"),
    ("taichi_sim.applications.trials", "taichi_sim.applications.sitl", "taichi_sim.applications.fit"),
    ("taichi_sim.visualisation.film",),
    ("taichi_sim.applications.commands",),
    ("rl.runs.signals", "rl.runs.ranks", "rl.guidance.course", "rl.step"),
    ("rl.perception",),
    ("rl.scenario",),
    ("rl.terms",),
    ("rl.team",),
    ("rl.judge", "rl.guidance.rewards"),
    ("rl.mission",),
    ("rl.guidance", "rl.evaluation.training_figures"),
    ("rl.missions", "rl.adapters.render", "rl.planning"),
    ("rl.learn",),
    ("rl.adapters.pilot",),
    ("rl.runs.folder", "rl.runs.torchrun"),
    ("rl.evaluation",),
    ("rl.runs",),
    ("rl.adapters",),
    ("rl.commands.shared",),
    COMMANDS,
    ("rl.commands",),
    ("tools",),
)
# Within a layer these know nothing of each other.
STRANGERS = (
    {"taichi_sim.surroundings.sea", "taichi_sim.surroundings.air"},
    {"taichi_sim.models.usv", "taichi_sim.models.uav"},
    {"taichi_sim.bench", "taichi_sim.visualisation.recording"},
    {*COMMANDS},
)
PACKAGES = ("taichi_sim", "rl", "tools")


def module_name(file: Path, root: Path) -> str:
    parts = file.relative_to(root).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def sources(root: Path) -> dict[str, Path]:
    """Every module of the three packages."""
    files = (file for package in PACKAGES for file in sorted((root / package).rglob("*.py")))
    return {module_name(file, root): file for file in files}


@cache
def statements(source: str) -> list[ast.Import | ast.ImportFrom]:
    """The import statements of a module."""
    return [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Import | ast.ImportFrom)]


def imports(name: str, file: Path, known: set[str]) -> Iterator[str]:
    """Modules of ours that a file imports, wherever in it the statement stands, and also if it is for types alone."""
    package = name if file.name == "__init__.py" else name.rpartition(".")[0]
    for node in statements(file.read_text(encoding="utf-8")):
        if isinstance(node, ast.Import):
            found = [alias.name for alias in node.names]
        else:
            base = node.module or ""
            if node.level:
                up = package.split(".")[: len(package.split(".")) - node.level + 1]
                base = ".".join([*up, base]).rstrip(".")
            inside = [f"{base}.{alias.name}" for alias in node.names]
            found = [full if full in known else base for full in inside]
        yield from (target for target in found if target.split(".")[0] in PACKAGES)


def place(module: str) -> tuple[int, str] | None:
    """Layer and name in LAYERS of a module; a whole package stands where its lowest module does.

    But `rl` stands with its adapters: importing it registers the Gymnasium ids.
    """
    module = "rl.adapters" if module == "rl" else module
    for height, layer in enumerate(LAYERS):
        for name in layer:
            inside = module == name or module.startswith(name + ".")
            if inside or name.startswith(module + "."):
                return height, name
    return None


def wrong_arrows(root: Path) -> list[str]:
    """Every import that runs from a lower layer to a higher one, or between strangers."""
    files, wrong = sources(root), []
    for module, file in files.items():
        here = place(module)
        if here is None:
            wrong.append(f"{module} has no place: add it to LAYERS")
            continue
        for target in imports(module, file, set(files)):
            there = place(target)
            if there is None:
                wrong.append(f"{module} imports {target}, which has no place in LAYERS")
            elif there[0] > here[0]:
                wrong.append(f"{module} imports {target}, which stands above it")
            elif here[1] != there[1] and any({here[1], there[1]} <= group for group in STRANGERS):
                wrong.append(f"{module} imports {target}, which stands beside it")
    return wrong


def test_no_arrow_runs_back():
    wrong = wrong_arrows(ROOT)
    assert not wrong, "\n".join(wrong)


def test_there_is_no_circle():
    files = sources(ROOT)
    graph = {module: set(imports(module, file, set(files))) for module, file in files.items()}
    try:
        tuple(TopologicalSorter(graph).static_order())
    except CycleError as error:
        pytest.fail(" -> ".join(error.args[1]))


def test_every_package_was_walked():
    modules = sources(ROOT)
    for package in PACKAGES:
        assert sum(name.startswith(package + ".") for name in modules) >= 2, package
    team = set(imports("rl.missions.formation.team", modules["rl.missions.formation.team"], set(modules)))
    assert team >= {"rl.perception.sensors", "rl.missions.formation.slots", "rl.guidance.residual"}


@pytest.mark.parametrize(
    ("module", "statement"),
    [
        ("taichi_sim/world.py", "from rl.scenario import derive_seed"),
        ("rl/perception/sensors.py", "import tools"),
        ("rl/missions/formation/mission.py", "def late():\n    from rl import train"),
        ("rl/missions/formation/mission.py", "from ...train import main"),
        ("rl/missions/formation/mission.py", "from ...commands import play"),
        ("taichi_sim/surroundings/sea/gerstner.py", "import taichi_sim.models.usv.unity_boat as boat"),
        ("taichi_sim/models/usv/unity_boat.py", "from taichi_sim.models.uav import unity_aircraft"),
        ("rl/learn/stages.py", "from tools import validate"),
        ("taichi_sim/__init__.py", "from taichi_sim.world import World"),
        ("taichi_sim/world.py", "if TYPE_CHECKING:\n    from rl.scenario import derive_seed"),
        ("rl/novelty.py", "import math"),
    ],
)
def test_an_arrow_that_runs_back_is_found(tmp_path, module, statement):
    for name in (
        "taichi_sim/models/usv/unity_boat", "taichi_sim/models/uav/unity_aircraft",
        "rl/train", "rl/commands/play", "rl/scenario",
        "taichi_sim/__init__", "rl/__init__", "tools/validate", "taichi_sim/world",
    ):  # fmt: skip
        file = tmp_path / f"{name}.py"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.touch()
    assert wrong_arrows(tmp_path) == []
    file = tmp_path / module
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(statement + "\n", encoding="utf-8")
    assert len(wrong_arrows(tmp_path)) == 1
