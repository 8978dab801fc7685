"""All that can be reached from an object, for tests of what a snapshot forgets."""

from types import BuiltinFunctionType, FunctionType, MethodType, ModuleType
from typing import Any

import numpy as np
import torch
from pydantic import BaseModel

from taichi_sim.kernels.runtime import Launcher

PASSED_OVER = (str, bytes, type, ModuleType, BuiltinFunctionType, BaseModel, Launcher, torch.dtype, torch.device)


def everything(root: Any) -> dict[str, Any]:
    """Path -> tensor, array, number or generator's state, copied, of all that is reachable from `root`.

    Looks into attributes, slots, containers, packs of kernels and what functions have closed over. Configurations and
    what Taichi has made are passed over.
    """
    found: dict[str, Any] = {}
    seen: set[int] = set()
    alive: list[Any] = []  # an identity may not be used again
    waiting = [(type(root).__name__, root)]
    while waiting:
        path, value = waiting.pop()
        if isinstance(value, bool | int | float | np.generic):
            found[path] = value
            continue
        if value is None or isinstance(value, PASSED_OVER) or id(value) in seen:
            continue
        seen.add(id(value))
        alive.append(value)
        if isinstance(value, torch.Tensor):
            found[path] = value.detach().clone()
        elif isinstance(value, np.ndarray):
            found[path] = value.copy()
        elif isinstance(value, torch.Generator):
            found[path] = value.get_state()
        elif isinstance(value, dict):
            waiting += [(f"{path}[{key!r}]", item) for key, item in value.items()]
        elif isinstance(value, list | tuple | set | frozenset):
            waiting += [(f"{path}[{k}]", item) for k, item in enumerate(value)]
        elif isinstance(value, FunctionType):
            waiting += [(f"{path}<{k}>", cell.cell_contents) for k, cell in enumerate(value.__closure__ or ())]
        elif isinstance(value, MethodType):
            waiting.append((f"{path}.__self__", value.__self__))
        elif not type(value).__module__.startswith("taichi."):
            slots = [name for kind in type(value).__mro__ for name in getattr(kind, "__slots__", ())]
            names = [*getattr(value, "__dict__", {}), *slots]
            waiting += [(f"{path}.{name}", getattr(value, name, None)) for name in names]
    return found


def differences(before: dict[str, Any], after: dict[str, Any]) -> list[str]:
    """Paths of what is not the same to the bit, NaN being the same as NaN."""
    return sorted(
        path
        for path in before.keys() | after.keys()
        if path not in before or path not in after or not _same(before[path], after[path])
    )


def _same(a: Any, b: Any) -> bool:
    a, b = (np.asarray(x.cpu() if isinstance(x, torch.Tensor) else x) for x in (a, b))
    return a.shape == b.shape and a.dtype == b.dtype and a.tobytes() == b.tobytes()
