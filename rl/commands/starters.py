"""Starter files: a scenario, a vehicle, a mission, each commented and complete.

A scenario is a copy of a shipped one; a vehicle and a mission are the examples of docs/extending.md, renamed.
"""

import keyword
import re
import sys
from importlib.machinery import PathFinder
from pathlib import Path

from rl.commands.tools_folder import bundle
from taichi_sim.config.base import ConfigError
from taichi_sim.config.io import find_config

BLOCK = re.compile(r"^```\w+ file=(\S+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def new_scenario(name: str, folder: Path, like: str = "paper") -> list[Path]:
    """Write NAME.toml, a commented copy of the scenario `like`."""
    source = find_config(like)
    text = source.read_text(encoding="utf-8")
    text = re.sub(r'^name = ".*"$', f'name = "{_name(name)}"', text, count=1, flags=re.MULTILINE)
    head = f"# Begun as a copy of {source.stem!r}. Train it: taichi-sim train --config {name}.toml\n#\n"
    return _write(folder, {f"{name}.toml": head + text})


def new_vehicle(name: str, folder: Path) -> list[Path]:
    """Write NAME.toml, a vehicle's numbers, and NAME.py, its physics."""
    files = _examples({"ferry": _name(name), "Ferry": _class(name)})
    return _write(folder, {file: files[file] for file in (f"{name}.toml", f"{name}.py")})


def new_mission(name: str, folder: Path) -> list[Path]:
    """Write NAME.toml, a scenario, and NAME.py, its mission, with a shipped vehicle."""
    files = _examples({"rendezvous": _name(name), "Rendezvous": _class(name)})
    scenario = files[f"{name}.toml"].replace('"ferry.toml"', '"unity_boat"').replace("ferries", "boats")
    return _write(folder, {f"{name}.toml": scenario, f"{name}.py": files[f"{name}.py"]})


def _examples(names: dict[str, str]) -> dict[str, str]:
    """The files of docs/extending.md, renamed."""
    page = (bundle() / "docs" / "extending.md").read_text(encoding="utf-8")

    def renamed(text: str) -> str:
        for old, new in names.items():
            text = re.sub(rf"\b{old}(?=\b|[A-Z_])", new, text)
        return text

    return {renamed(file): renamed(text) for file, text in BLOCK.findall(page)}


def _name(name: str) -> str:
    """Return a name that can name a new module; ConfigError for any other."""
    elsewhere = [place for place in sys.path if place and Path(place).resolve() != Path.cwd()]
    if keyword.iskeyword(name) or name in sys.builtin_module_names or PathFinder.find_spec(name, elsewhere):
        raise ConfigError(f"{name!r}: Python has a word or a module of this name, which yours would hide: another name")
    if not name.isidentifier() or name != name.lower():
        raise ConfigError(f"{name!r}: a name is of small letters, digits and _, and begins with a letter: harbour_2")
    return name


def _class(name: str) -> str:
    return "".join(part.capitalize() for part in name.split("_"))


def _write(folder: Path, files: dict[str, str]) -> list[Path]:
    """Write all files, or none of them: ConfigError if one exists already."""
    for name in files:
        if (folder / name).exists():
            raise ConfigError(f"{folder / name}: exists already; choose another name, or remove it")
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")
    return [folder / name for name in files]
