"""User classes that a configuration names as `module:Class`.

The module is searched beside the file that names it, in the working folder, and among the installed packages. Naming a
class runs its code, so a configuration from a stranger is a program from a stranger.
"""

import importlib
import importlib.util
import sys
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import TypeVar, overload

from taichi_sim.config import ConfigError

Class = TypeVar("Class")
OURS = ("taichi_sim", "rl")  # names that always mean our packages, even beside a folder of that name


def plugin_source(name: str, beside: Sequence[Path] = ()) -> Path | None:
    """File or package folder of `module:Class`; None for a class of ours, an installed one, or a missing one."""
    top = name.partition(":")[0].partition(".")[0]
    if top in OURS:
        return None
    for folder in (*beside, Path.cwd()):
        for place in ((folder / top).with_suffix(".py"), folder / top):
            if place.is_file() or (place / "__init__.py").is_file():
                return place
    return None


def is_plugin(name: str) -> bool:
    """Whether `name` is written as `module:Class`."""
    return ":" in name


@overload
def load_class(name: str, base: type[Class], beside: Sequence[Path] = ()) -> type[Class]: ...
@overload
def load_class(name: str, base: None = None, beside: Sequence[Path] = ()) -> object: ...
def load_class(name: str, base: type | None = None, beside: Sequence[Path] = ()) -> object:
    """Import the class (or function) with the name `module:Class`.

    Args:
        name: `package.module:Class`.
        base: class that it must derive from; None: any object.
        beside: folders to search first, those of the files that name it.
    """
    module_name, _, attribute = name.partition(":")
    if not module_name or not attribute:
        raise ConfigError(f"{name!r}: expected module:Class")
    module = _import(name, module_name, [*beside, Path.cwd()])
    found: object = module
    for part in attribute.split("."):
        found = getattr(found, part, None)
        if found is None:
            raise ConfigError(f"{name!r}: {module.__file__ or module_name} has no {attribute!r}")
    if base is not None and not (isinstance(found, type) and issubclass(found, base)):
        raise ConfigError(f"{name!r}: {attribute} is not a class that derives from {base.__module__}.{base.__name__}")
    return found


class PluginError(ConfigError):
    """A user's module cannot be imported."""


_origins: dict[str, Path] = {}  # top-level names imported here from a folder, and by what was -> that folder, the last
_tops: dict[Path, set[str]] = {}  # folder -> all such names


def imported_from(folder: Path) -> list[Path]:
    """Files and package folders in `folder` that plug-ins were imported from, with what these imported from there."""
    found = (plugin_source(f"{top}:", [folder]) for top in _tops.get(folder.resolve(), ()))
    return [place for place in found if place is not None]


def _import(name: str, module_name: str, folders: list[Path]) -> ModuleType:
    """Import the module from the first of `folders` that holds it, otherwise from the installed packages."""
    top = module_name.partition(".")[0]
    folder = next((folder.resolve() for folder in folders if top not in OURS and _holds(folder, module_name)), None)
    # other modules of these names were imported from other folders
    others = {other for other, origin in _origins.items() if origin != folder}
    others = {other for other in others if other == top or (folder and _holds(folder, other))}
    aside = {key: sys.modules.pop(key) for key in list(sys.modules) if key.partition(".")[0] in others}
    if folder is None:
        return _imported(name, module_name)
    if top in sys.modules and not _lies_in(sys.modules[top], folder):
        raise ConfigError(
            f"{name!r}: another {top} is in use already, of {getattr(sys.modules[top], '__file__', None)}: rename that "
            f"of {folder}"
        )
    before = set(sys.modules)
    sys.path.insert(0, str(folder))
    try:
        return _imported(name, module_name)
    finally:
        sys.path.remove(str(folder))
        helpers = {key for key in sys.modules.keys() - before if "." not in key and _lies_in(sys.modules[key], folder)}
        _origins.update(dict.fromkeys(helpers, folder))
        _tops.setdefault(folder, set()).update({top, *helpers})
        # what this one did not need stays where pickle finds it
        sys.modules.update({key: of for key, of in aside.items() if key.partition(".")[0] not in helpers})


def _lies_in(top: ModuleType, folder: Path) -> bool:
    """Whether an imported top-level module or package comes from `folder`."""
    places = getattr(top, "__path__", None) or [getattr(top, "__file__", None) or ""]
    return any(place and Path(place).parent.resolve() == folder for place in places)


def _imported(name: str, module_name: str) -> ModuleType:
    try:
        return importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        if error.name is not None and (module_name == error.name or module_name.startswith(f"{error.name}.")):
            raise PluginError(
                f"{name!r}: no module {module_name!r} beside the file, in the working folder, or installed"
            ) from None
        raise PluginError(f"{name!r}: importing {module_name} failed: {error}") from error
    except Exception as error:  # any error in the user's module
        raise PluginError(f"{name!r}: importing {module_name} failed: {type(error).__name__}: {error}") from error


def _holds(folder: Path, module_name: str) -> bool:
    """Whether a module or package of that name lies in `folder`."""
    place = folder.joinpath(*module_name.split("."))
    return place.with_suffix(".py").is_file() or (place / "__init__.py").is_file()
