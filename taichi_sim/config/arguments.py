"""Validates user input (counts, seeds, environments, actions) before anything changes.

A value is never taken for something else because of its type: a mask of environments is bool, numbers of environments
are whole, and what could be either is refused.
"""

import math
import operator
from collections.abc import Iterable, Sequence
from contextlib import suppress
from typing import TypeAlias

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from taichi_sim.errors import UserError
from taichi_sim.kernels import runtime

Envs: TypeAlias = ArrayLike | Tensor
"""Environments: numbers [n], or a bool mask [env]."""


MASK = "if a mask is meant, convert it by mask.bool() (of an array: mask.astype(bool))"


class ActionError(UserError, ValueError):
    """An action that is not finite, or cannot be one."""


def whole_number(given: object, name: str, least: int = 0) -> int:
    """A count or a seed.

    Raises:
        ValueError: for anything but a whole number of at least `least`; 2.0, "3" and True are none.
    """
    if not isinstance(given, bool | np.bool_):
        with suppress(TypeError, ValueError):
            if (number := operator.index(given)) >= least:  # pyright: ignore[reportArgumentType]
                return number
    raise ValueError(f"{name} = {given!r} must be a whole number, at least {least}")


def names(given: object, what: str) -> tuple[str, ...]:
    """Names, as of teams; one string is none."""
    if isinstance(given, str) or not isinstance(given, Iterable):
        raise ValueError(f"{what} = {given!r}: a list of names is expected, [{given!r}]")
    return tuple(map(str, given))


def _tensor(given: object) -> Tensor:
    """A dense tensor of numbers; what torch would drop, as NumPy's masks, or cannot calculate with is a ValueError."""
    values = torch.as_tensor(given, device=runtime.current().device).detach()
    if values.is_floating_point() and not hasattr(given, "dtype"):  # Python's numbers have 53 bits
        values = torch.as_tensor(given, dtype=torch.float64, device=values.device)
    small = values.is_floating_point() and values.itemsize < 2
    if small or values.layout != torch.strided or np.ma.is_masked(given):
        raise ValueError("a dense tensor or array of 16 bits or more is expected, with no entry masked")
    return values


def numbers(given: object, what: str) -> Tensor:
    """A tensor of `given`, a tensor, an array or nested sequences of numbers, without its gradient."""
    try:
        values = _tensor(given)
        if values.dtype == torch.bool or values.is_complex():
            raise ValueError(f"real numbers are expected, not {values.dtype}")
        return values
    except (TypeError, ValueError, RuntimeError) as error:
        raise ActionError(f"{what} cannot be read as one tensor of numbers: {str(error).splitlines()[0]}") from None


def checked_action(
    given: object, team: str, names: Sequence[str], shape: tuple[int, int], dtype: torch.dtype
) -> Tensor:
    """The actions of a team [env, vehicle, action] as a new tensor of `dtype`, clipped to [-1, 1].

    Args:
        given: these actions, any type of numbers. team: its name. names: of the actions. shape: (env, vehicle).
        dtype: of the result.
    """
    action, expected = numbers(given, f"actions of {team}"), (*shape, len(names))
    if tuple(action.shape) != expected:
        raise ActionError(f"actions of {team} have shape {tuple(action.shape)}, expected {expected}")
    if not math.isfinite(action.sum()) and not (finite := action.isfinite()).all():  # a sum may overflow
        env, number, index = (~finite).nonzero()[0].tolist()
        raise ActionError(
            f"{team} action {names[index]!r} of {team}_{number} in environment {env} is "
            f"{action[env, number, index].item()}: actions must be finite"
        )
    return action.clamp(-1.0, 1.0).to(dtype).contiguous()


def environments(
    given: Envs,
    num_envs: int,
    name: str = "envs",
    *,
    whole: bool = False,
    twice: bool = False,
    one: str = "environment",
) -> Tensor:
    """Numbers of environments, int64 [n], from such numbers or from a bool mask [env].

    Args:
        given: the environments. num_envs: how many there are. name: of the argument. whole: whether numbers are meant
            for certain; otherwise an array or tensor of `num_envs` zeros and ones is refused, because it may be meant
            as a mask. twice: whether an environment may be named twice. one: what a message calls one of them.

    Raises:
        ValueError: for other types, a mask of another length, environments that do not exist or are named twice.
    """
    try:
        values = _tensor(given)
    except (TypeError, ValueError, RuntimeError):
        raise ValueError(f"{name} = {given!r}: numbers of {one}s or a bool mask [{num_envs}] expected") from None
    kind, shape, told = values.dtype, list(values.shape), ""
    if kind == torch.bool and shape == [num_envs]:
        return values.nonzero().squeeze(1)
    if not values.numel() and kind != torch.bool:
        return values.new_zeros(0, dtype=torch.int64)
    if kind == torch.bool or values.dim() > 1:
        told = f"have shape {shape}, expected [n], or a bool mask [{num_envs}]"
    elif values.is_floating_point() or values.is_complex() or kind == torch.uint8:
        told = f"are numbers of {one}s or a bool mask, not {kind}: {MASK}"
    else:
        envs = values.long().reshape(-1)
        ordered = bool((envs[1:] > envs[:-1]).all())  # so that none is twice
        low, high = (int(end) for end in (envs[[0, -1]] if ordered else envs.aminmax()))
        flags = len(envs) == num_envs and low >= 0 and high <= 1
        if flags and not whole and not isinstance(given, Sequence | int):
            told = f"are {num_envs} zeros and ones of {kind}: {MASK}; for numbers pass a list"
        elif low < 0 or high >= num_envs:
            told = f"name {one} {low if low < 0 else high}: there are 0 to {num_envs - 1}"
        elif twice or ordered or int((times := envs.bincount()).max()) < 2:
            return envs
        else:
            told = f"name {one} {int(times.argmax())} twice" + f" ({MASK})" * flags
    raise ValueError(f"{name} {told}")
