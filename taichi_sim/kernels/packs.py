"""Arguments of vehicle kernels: packs of tensors, compile-time choices, and each vehicle's own numbers."""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

from functools import cache
from typing import Any, NamedTuple

import taichi as ti

from taichi_sim.kernels import runtime
from taichi_sim.kernels.lanes import laned2, laned3

_array1, _array2, _array3 = (ti.types.ndarray(ndim=n) for n in (1, 2, 3))
_whole1 = ti.types.ndarray(dtype=ti.i32, ndim=1)

FleetPack = ti.types.argpack(
    state=_array3, derived=_array3, aux=_array3, surface=_array3, action=_array3, numbers=_array3, load=_array3,
    lanes=laned3,
)  # fmt: skip
"""A team, each [env, vehicle, n] (fleet.py); `numbers` and `load` are [1, 1, 1] where they are not used; `lanes`
is aux in lanes, of models whose `aux_size` fills them."""

AroundPack = ti.types.argpack(
    sea=_array3, env_sea=_whole1, phase=_array2, current=_array2, wind=_array2, air=_array1,
    turbulence=_array1, count=_whole1, waves=laned3, turns=laned2,
)  # fmt: skip
"""The surroundings (surroundings.py); `air` = (shear, w20, w20_factor) is of the wind (`Wind.numbers`), `turbulence`
[env] the factor of its intensity where that differs (else not to be read), `count` [2 + env] counts the random numbers
(counters.py); `waves` and `turns` are sea and phase in lanes."""


TouchPack = ti.types.argpack(way=_array3, pressing=_array3, soles=_array3, struck=_array3, blow=_array3)
"""Of a team with legs, each [env, vehicle, n]: the decks near by and what it remembers of them (contact/touch.py)."""


class Build(NamedTuple):
    """Compile-time choices of a kernel; read inside `ti.static`."""

    components: int = 1  # of the sea
    finite: bool = False  # depth of the water
    varied: bool = False  # numbers differ between environments: `fleet.numbers` counts
    loaded: bool = False  # `fleet.load` counts
    air: Any = None  # kind of air (uav/local_air.py), of models that ask
    decked: bool = False  # there are decks for it to stand on: `fleet.touch` counts
    serial: bool = False  # on the calling thread: so few vehicles that waking others would cost more


@cache
def struct_of(names: tuple[str, ...], precision: runtime.Precision) -> Any:
    """A Taichi struct with a float of that precision for each of `names`."""
    kind = ti.f64 if precision == "f64" else ti.f32
    return ti.types.struct(**{name: kind for name in names})


@ti.func
def numbers_at(kind: ti.template(), numbers: ti.template(), e, i):
    """The row of `numbers` [env, vehicle, n] of vehicle i in environment e, as a struct of the type `kind`."""
    return kind(*[numbers[e, i, k] for k in ti.static(range(len(kind.members)))])


@ti.func
def values_at(kind: ti.template(), values: ti.template()):
    """The first of `values` [n], as a struct of the type `kind`."""
    return kind(*[values[k] for k in ti.static(range(len(kind.members)))])


@ti.func
def load_at(build: ti.template(), load: ti.template(), e, i):
    """Load from outside on vehicle i in environment e: six numbers (N, N m, b), zero where none is built in."""
    tau = ti.Vector([0.0 for _ in ti.static(range(6))])
    if ti.static(build.loaded):
        for c in ti.static(range(6)):
            tau[c] = load[e, i, c]
    return tau
