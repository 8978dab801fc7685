"""Arguments of vehicle kernels: packs of tensors, compile-time options, and the numbers of each vehicle."""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

from collections.abc import Hashable
from functools import cache
from typing import Any, NamedTuple

import taichi as ti
from taichi.lang import impl
from taichi.lang.struct import StructType

from taichi_sim.kernels import runtime
from taichi_sim.kernels.abreast import Record, taken
from taichi_sim.kernels.lanes import in_kernels, is_laned, laned1, laned2, laned3
from taichi_sim.kernels.runtime import array1, array2, array3, whole1

PART = 32  # numbers that are read at a time: Taichi warns of longer loops without need

FleetPack = ti.types.argpack(
    state=array3, derived=array3, aux=array3, surface=array3, action=array3, numbers=array3, load=array3,
    remainder=array2, rests=laned2, lanes=laned3,
)  # fmt: skip
"""Tensors of a team, each [env, vehicle, n] (fleet.py). `numbers` and `load` are [1, 1, 1] where they are not used.
`remainder` [3, vehicle of all environments] is what `state` cannot hold of the position (position.py), `rests` the same
as vectors. `lanes` is `aux` as vectors (lanes.py), for
models whose `aux_size` is a multiple of the width."""

AroundPack = ti.types.argpack(
    sea=array3, env_sea=whole1, phase=array2, current=array2, wind=array2, air=array1,
    turbulence=array1, count=whole1, waves=laned1, turns=laned2,
)  # fmt: skip
"""The surroundings (around_vehicles.py). `air` = (shear, w20, w20_factor) comes from `Wind.numbers`. `turbulence` [env]
is a factor of the turbulence intensity; it is read only where the factor varies. `count` [2 + env] is the counter of
random numbers (random.py). `waves` and `turns` are `sea` and `phase` as vectors (lanes.py), `waves` without axes."""

TouchPack = ti.types.argpack(way=array3, pressing=array3, soles=array3, struck=array3, blow=array3)
"""Nearby decks and remembered contacts of a team with legs, each [env, vehicle, n] (contact/leg_contact.py)."""


class Build(NamedTuple):
    """Compile-time options of a kernel, read inside `ti.static`."""

    components: int = 1  # number of wave components
    finite: bool = False  # whether the water has finite depth
    varied: bool = False  # whether numbers differ between environments, so that `fleet.numbers` is read
    loaded: bool = False  # whether `fleet.load` is read
    air: Hashable = None  # kind of air (uav/local_air.py), for models that use it
    decked: bool = False  # whether there are decks to stand on, so that `fleet.touch` is read
    width: int = 1  # number of vehicles that a loop takes at a time (abreast.py)

    @property
    def serial(self) -> bool:
        """Whether the kernel that is being compiled runs on the calling thread."""
        return runtime.loop.serial

    @property
    def block(self) -> int:
        """Turns of a vehicle loop that a thread takes at a time, some 10 us of work; on a GPU, of a block."""
        return 128 if runtime.current().arch == "cuda" else 4


@cache
def struct_of(names: tuple[str, ...], precision: runtime.Precision) -> StructType:
    """Return a Taichi struct type with one float of the given precision for each of `names`."""
    kind = ti.f64 if precision == "f64" else ti.f32
    return ti.types.struct(**{name: kind for name in names})


@in_kernels
def numbers_at(kind: StructType, numbers: Any, e: Any, i: Any) -> Any:
    """Numbers of vehicle i in environment e, a row of `numbers` [env, vehicle, n], as a struct of type `kind`.

    Those of a group (abreast.py) are a `Record`.
    """
    names = tuple(kind.members)
    if not is_laned(e):
        return kind(*[impl.subscript(None, numbers, e, i, k) for k in range(len(names))])
    values = [x for k in range(0, len(names), PART) for x in taken(numbers, e, i, k, min(PART, len(names) - k)).entries]
    return Record(**dict(zip(names, values, strict=True)))


@in_kernels
def own_numbers(model: Any, build: Build, numbers: Any, e: Any, i: Any) -> Any:
    """Numbers of vehicle i in environment e: the constants of the `model`; its own where they vary (`numbers_at`)."""
    return impl.expr_init(numbers_at(model.Own, numbers, e, i)) if build.varied else model.constants


@ti.func
def values_at(kind: ti.template(), values: ti.template()):
    """The first entries of `values` [n] as a struct of type `kind`."""
    return kind(*[values[k] for k in ti.static(range(len(kind.members)))])


@ti.func
def load_at(build: ti.template(), load: ti.template(), e, i):
    """External load on vehicle i in environment e: six numbers (N, N m, b), zero where `build` has no load."""
    if ti.static(build.loaded):
        return taken(load, e, i, 0, 6)
    else:
        return ti.Vector([0.0 for _ in ti.static(range(6))])
