"""Numbers that a hull's kernels use: compiled in, or read for each vehicle if they vary.

Mass and CG affect everything that depends on them: M_rb (rigid_body.changed_mass) and the weight, and through it the
draught, list and trim of a hull on panels. `restoring = "linear"` keeps the published G, so mass does not change the
draught there.
"""

from collections import namedtuple
from collections.abc import Callable, Mapping, Sequence
from functools import cache

import numpy as np
import torch
from torch import Tensor

from taichi_sim.conventions import GRAVITY
from taichi_sim.kernels.rigid_body import changed_mass
from taichi_sim.usv.hull.params import Hull6DofParams
from taichi_sim.usv.hull.radiation import Radiation
from taichi_sim.usv.mmg import DERIVATIVES, OF_PARTS, part_numbers, polynomial_numbers
from taichi_sim.usv.vessel import RHO_AIR, Number
from taichi_sim.vehicle import left_of

MASS, LAG = "rigid_body.mass", "thrusters.lag"
CG = tuple(f"rigid_body.cg.{i}" for i in range(3))
ADDED_MASS, LINEAR, QUADRATIC = (
    tuple(f"hydrodynamics.{name}.{i}" for i in range(6)) for name in ("added_mass", "linear", "quadratic")
)
GAINS = ("thrusters.gain_left", "thrusters.gain_right")
DECK_FRICTION = "deck.friction"
AREAS = ("windage.frontal_area", "windage.lateral_area")
UPPER = tuple((i, j) for i in range(6) for j in range(i, 6))  # entries of a symmetric 6 x 6 matrix

FIELDS = (
    "weight",  # N
    *(f"cg_{i}" for i in range(3)),  # m, b
    *(f"added_{i}" for i in range(6)),  # diagonal of M_a, kg, kg m^2
    *(f"linear_{i}" for i in range(6)),  # damping, N s/m, N m s
    *(f"quadratic_{i}" for i in range(6)),  # N s^2/m^2, N m s^2
    "wind_x", "wind_y", "wind_n",  # factors of products of relative wind speeds (vessel.py), N s^2/m^2, N s^2/m
    *(f"M_rb_{i}{j}" for i, j in UPPER),
    *(f"inverse_{i}{j}" for i, j in UPPER),  # inverse of M_rb + M_a
)  # fmt: skip
THRUSTER_FIELDS = (  # for each thruster k (`THRUSTER_FIELDS`_k), after FIELDS
    "keep_half", "keep",  # share of its speed's deviation from the command that is left after half a step, after one
    "gain",  # factor of its thrust
)  # fmt: skip


@cache
def numbers_of(thrusters: int, mmg: tuple[str, ...] = ()) -> Callable[..., tuple[Number, ...]]:
    """NamedTuple type of a hull with this many thrusters, or with the fields `mmg` of its propellers and rudders (see
    `FIELDS`); its entries are floats, or tensors of one shape.
    """
    fitted = (f"{name}_{k}" for name in THRUSTER_FIELDS for k in range(thrusters))
    return namedtuple("HullNumbers", (*FIELDS, *fitted, *mmg))


def varying_keys(p: Hull6DofParams) -> tuple[str, ...]:
    """Keys of the vehicle file that may differ between environments."""
    gains, lags = thruster_keys(p)
    thrusters = (*gains, *dict.fromkeys(lags))
    deck = (DECK_FRICTION,) if p.deck else ()  # contact/contacts.py reads it
    return (MASS, *CG, *ADDED_MASS, *LINEAR, *QUADRATIC, *thrusters, *mmg_keys(p), *AREAS, *deck)


def mmg_keys(p: Hull6DofParams) -> tuple[str, ...]:
    """Keys of propellers, rudders and polynomial."""
    if p.mmg is None:
        return ()
    derivatives = tuple(f"hull.{name}" for name in DERIVATIVES) if p.mmg.hull else ()
    return tuple(f"mmg.{key}" for key in (*derivatives, *OF_PARTS))


def mmg_numbers(p: Hull6DofParams, dt: float, values: Mapping[str, Number]) -> dict[str, Number]:
    """Numbers of one propeller, one rudder and the polynomial (usv/mmg.py), by field."""
    m = p.mmg
    if m is None:
        return {}
    own = {key.removeprefix("mmg."): values[key] for key in mmg_keys(p)}
    found = part_numbers(own, m.propeller, m.rudder, 1, 1, m.length, m.density, dt)
    return found | (polynomial_numbers(own, m.length, m.draft, m.density) if m.hull else {})


def thruster_keys(p: Hull6DofParams) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Keys of the thrusters' gains, and of their lags."""
    if p.thrusters:
        return GAINS, (LAG, LAG)
    return tuple(f"actuators.{name}.gain" for name in p.actuators), tuple(f"actuators.{n}.lag" for n in p.actuators)


def hull_numbers(
    p: Hull6DofParams, radiation: Radiation, dt: float, values: Mapping[str, Number]
) -> tuple[Number, ...]:
    """Numbers of a hull with `values` for `varying_keys` (floats or float64 tensors), stepped by `dt` (s)."""
    mass, cg = values[MASS], [values[key] for key in CG]
    added, linear, quadratic = ([values[key] for key in keys] for keys in (ADDED_MASS, LINEAR, QUADRATIC))
    M_rb = changed_mass(p.M_rb, p.rigid_body.mass, p.rigid_body.cg, mass, cg)
    M = [[M_rb[i][j] + float(radiation.inertia[i, j]) for j in range(6)] for i in range(6)]
    change = [value - nominal for value, nominal in zip(added, p.hydrodynamics.added_mass, strict=True)]
    for i, more in enumerate(radiation.inertia_change(change)):
        M[i][i] = M[i][i] + more
    linear = [_beyond(value, float(counted)) for value, counted in zip(linear, radiation.counted, strict=True)]
    inverse = _inverse(M)
    w, (frontal, lateral) = p.windage, (values[key] for key in AREAS)
    gains, lags = ([values[key] for key in keys] for keys in thruster_keys(p))
    mmg = mmg_numbers(p, dt, values)
    return numbers_of(len(gains), tuple(mmg))(
        mass * GRAVITY, *cg, *added, *linear, *quadratic,
        0.5 * RHO_AIR * w.c_x * frontal, 0.5 * RHO_AIR * w.c_y * lateral, RHO_AIR * w.c_n * lateral * p.length,
        *(M_rb[i][j] for i, j in UPPER), *(inverse[i][j] for i, j in UPPER),
        *(left_of(0.5 * dt, lag) for lag in lags), *(left_of(dt, lag) for lag in lags), *gains, *mmg.values(),
    )  # fmt: skip


def _beyond(value: Number, counted: float) -> Number:
    """The part of a damping that is not in `counted`."""
    if counted == 0.0:
        return value
    return (value - counted).clamp(min=0.0) if isinstance(value, Tensor) else max(value - counted, 0.0)


def _inverse(rows: list[list[Number]]) -> Sequence[Sequence[Number]]:
    """Inverse of a 6 x 6 matrix of floats, or of floats and tensors of one shape; the entries are of the same kind."""
    entries = [x for row in rows for x in row]
    given = next((x for x in entries if isinstance(x, Tensor)), None)
    if given is None:
        return np.linalg.inv(np.array(rows)).tolist()
    whole = torch.stack([torch.as_tensor(x, dtype=given.dtype, device=given.device).expand_as(given) for x in entries])
    inverse = torch.linalg.inv(whole.movedim(0, -1).unflatten(-1, (6, 6)))
    return [row.unbind(-1) for row in inverse.unbind(-2)]


# -- inside `ti.static`: `p` is a HullNumbers, or the struct with those of one vehicle -----------------------------


def vector(p: object, name: str, size: int) -> tuple[Number, ...]:
    """The numbers `name`_0, `name`_1, ..."""
    return tuple(getattr(p, f"{name}_{i}") for i in range(size))


def diagonal(p: object, name: str) -> tuple[tuple[Number, ...], ...]:
    """Rows of the 6 x 6 matrix with the diagonal `name`_i."""
    return tuple(tuple(x if i == j else 0.0 for j in range(6)) for i, x in enumerate(vector(p, name, 6)))


def symmetric(p: object, name: str) -> tuple[tuple[Number, ...], ...]:
    """Rows of the symmetric 6 x 6 matrix `name`_ij."""
    return tuple(tuple(getattr(p, f"{name}_{min(i, j)}{max(i, j)}") for j in range(6)) for i in range(6))
