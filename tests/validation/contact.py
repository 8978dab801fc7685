"""Checks of contact (taichi_sim/models/contact/) against closed forms: contact_closed_forms*.json.

Keys, each a list of objects but for `tip_over`, all optional: `leg` (m_kg, k_N_m, c_N_s_m of all legs together,
touch_speed_m_s, max_sink_m, sink_at_t, lift_off_t_s), `block_on_tilted_deck` (mu, deck_tilt_deg, state,
acceleration), `sliding_stop_on_level_deck` (mu, v0, distance), `tip_over` (half_base_lateral_m,
half_base_longitudinal_m, com_height_m, lateral_deg, longitudinal_deg), `impact_drone_boat_free_bodies` (m_drone,
m_boat, boat_inertia_about_axis, lever_m, drone_down_before, boat_point_down_before). The aircraft is that of
params_x500.json on four soles.

A table of impacts takes a restitution e as given; here it follows from spring and damper. So its impulse is compared as
(1 + e) times that of e = 0, with the e that our blow shows; the weight's own impulse is taken off.
"""

import functools
import math

import numpy as np
import torch
from torch import Tensor

from taichi_sim.bench import calm_sea
from taichi_sim.config import Strict
from taichi_sim.fleet import Fleet
from taichi_sim.kernels.conventions import GRAVITY, VELOCITY
from taichi_sim.kernels.rotation import torch_quaternion_from_euler, torch_rotation_matrix
from taichi_sim.models.contact.between_teams import Contacts
from taichi_sim.models.contact.deck_and_legs import Deck, Legs
from taichi_sim.models.uav.multirotor.multirotor_6dof import Multirotor6DOF
from taichi_sim.models.uav.multirotor.params import MultirotorParams
from taichi_sim.surroundings.around_vehicles import Surroundings
from taichi_sim.vehicle import Vehicle
from tests.validation.case import Case
from tests.validation.multirotor import parameters
from tests.validation.tables import TableError, number, read_json, records

DT = 0.01  # s
STIFF, FIRM = 20_000.0, 80.0  # N/m and N s/m of each leg where bending would change the geometry
RIGID, HARD = 2e5, 250.0  # N/m and N s/m: a sudden start on springs tips an aircraft early
SOLE = 0.25  # m, z of the soles in the airframe's frame
LOW = 0.02  # m, height of a block's centre of gravity over its soles: it does not tip
Base = tuple[float, float]
HALF_BASE: Base = (0.125, 0.132)  # m, along and across, without `tip_over`
STEEL = 2e5  # N/m of all legs together, in a blow
FAN = np.radians(np.linspace(-3.0, 3.0, 17))  # tilts about that at which an aircraft tips; as few as one kernel serves
SINK, SLIDE, TIP_DEG, BLOW = 0.01, 0.005, 0.75, 1e-6  # of the deepest sink; of an acceleration; deg; of an impulse
OFF_CENTRE = 5e-3  # of an impulse at a lever: the deck turns while the blow lasts
NO_THRUST = {f"rotor.{key}": 0.0 for key in ("k_d", "k_z", "k_h", "k_flap", "J_r")} | {
    "rotor.k_f": 1e-30, "rotor.k_m": 1e-30, **{f"physical.drag.{k}": 0.0 for k in range(3)}
}  # fmt: skip


class SlabParams(Strict):
    """Of all slabs."""

    deck: Deck
    size: tuple[float, float, float] = (10.0, 10.0, 0.1)
    collision_radius: float = 7.0


class Slab(Vehicle):
    """Bodies with a deck that stay, or that move freely without turning out of the vertical by much.

    Attributes:
        mobility_of: [env, 1, 6, 6].
    """

    Params = SlabParams
    action_names = control_names = ("nothing",)
    varying = ("deck.friction",)

    def __init__(self, params: SlabParams, dt: float, inverse_mass: np.ndarray, inverse_inertia: np.ndarray):
        """Inverse masses (1/kg) and inertias (1/(kg m^2)) [env]; 0 stays."""
        super().__init__(params, dt, 1)
        self.deck = params.deck
        diagonal = np.stack([inverse_mass] * 3 + [inverse_inertia] * 3, axis=-1)
        self.mobility_of = torch.diag_embed(torch.from_numpy(diagonal))[:, None]

    def mobility(self, fleet: Fleet) -> Tensor:
        """Of each environment."""
        return self.mobility_of

    def step(self, fleet: Fleet, around: Surroundings) -> None:
        """Under the load of the last step: half a drift, a kick, half a drift."""
        state, push = fleet.state, (self.mobility_of @ fleet.load.double().unsqueeze(-1)).squeeze(-1).to(fleet.state)
        for half in range(2):
            R = torch_rotation_matrix(state[..., 3:7])
            state[..., :3] += 0.5 * self.dt * (R @ state[..., VELOCITY].unsqueeze(-1)).squeeze(-1)
            w = 0.25 * self.dt * state[..., 10:]
            q = state[..., 3:7].clone()
            state[..., 3] -= (q[..., 1:] * w).sum(-1)
            state[..., 4:7] += q[..., :1] * w + torch.linalg.cross(q[..., 1:], w)
            state[..., 3:7] /= state[..., 3:7].norm(dim=-1, keepdim=True)
            if half == 0:
                state[..., 7:] += self.dt * push
        fleet.update()


@functools.cache
def _model(craft: str) -> Multirotor6DOF:
    """One model, and one compiled kernel, for all trials of an aircraft (its parameters as JSON)."""
    return Multirotor6DOF(MultirotorParams.model_validate_json(craft), DT, 1)


class Trial:
    """An aircraft without thrust on a slab in each environment.

    Attributes:
        slabs, aircraft: the fleets. low: height [env] (m) of the aircraft's centre of gravity over its soles.
    """

    def __init__(self, craft: MultirotorParams, envs: int, half_base: Base, slab=(0.0, 0.0)):
        """half_base: of the soles, along and across (m). slab: inverse mass and inertia, each a number or [env]."""
        soles = tuple((x * half_base[0], y * half_base[1], SOLE) for x in (-1, 1) for y in (-1, 1))
        legs = Legs(points=soles, stiffness=RIGID, damping=0.0)  # steps of contact are those of the stiffest
        craft = craft.model_copy(update={"legs": legs, "ground_effect": False})
        deck = SlabParams(deck=Deck(place=(0.0, 0.0), size=(9.0, 9.0), height=0.1, friction=0.5))
        inverse = [np.broadcast_to(np.asarray(x, dtype=np.float64), envs).copy() for x in slab]
        self.slabs = Fleet("slabs", Slab(deck, DT, inverse[0], inverse[1]), envs, 1)
        self.aircraft = Fleet("aircraft", _model(craft.model_dump_json()), envs, 1)
        self.contacts = Contacts({"slabs": self.slabs, "aircraft": self.aircraft}, DT)
        time = torch.zeros(envs, dtype=torch.float64)
        self.around = Surroundings.of(calm_sea(), torch.zeros(envs, dtype=torch.int32), time)

    def numbers(self, low, mass=None, stiffness=STIFF, damping=FIRM, friction=0.5) -> None:
        """Of each environment, or of all: height of the centre of gravity over the soles (m), mass (kg), each leg."""
        given = NO_THRUST | {
            "legs.stiffness": stiffness,
            "legs.damping": damping,
            "physical.cg.2": SOLE - np.array(low),
        }
        if mass is not None:
            given["physical.mass"] = mass
        self.low = np.broadcast_to(low, self.aircraft.num_envs)
        columns = {key: np.reshape(np.asarray(value, dtype=np.float64), (-1, 1)) for key, value in given.items()}
        self.aircraft.set_numbers({key: torch.tensor(value) for key, value in columns.items()})
        self.rough(friction)

    def rough(self, friction) -> None:
        """The decks' friction."""
        self.slabs.set_numbers({"deck.friction": torch.tensor(np.reshape(np.asarray(friction, float), (-1, 1)))})

    def put(self, roll=0.0, pitch=0.0, lever=0.0, sink=0.0, velocity=(0.0, 0.0, 0.0), rise=0.0) -> None:
        """Slabs tilted, aircraft on them `lever` m ahead, `sink` m in; its velocity and the slab's, down (m/s)."""
        envs = self.aircraft.num_envs
        columns = np.broadcast_arrays(roll, pitch, lever, self.low + 0.1 - np.asarray(sink), rise, np.zeros(envs))
        roll, pitch, lever, up, rise, zero = (torch.from_numpy(np.array(x, dtype=np.float64)) for x in columns)
        for fleet, place, v in (
            (self.slabs, (zero, zero, zero), torch.stack((zero, zero, rise), -1)),
            (self.aircraft, (lever, zero, -up), torch.from_numpy(np.broadcast_to(velocity, (envs, 3)).copy())),
        ):
            q = torch_quaternion_from_euler(roll, pitch, zero)
            R = torch_rotation_matrix(q)
            fleet.state[:, 0, :3] = (R @ torch.stack(place, -1).unsqueeze(-1)).squeeze(-1).to(fleet.state)
            fleet.state[:, 0, 3:7], fleet.state[:, 0, VELOCITY] = q.to(fleet.state), v.to(fleet.state)
            fleet.state[:, 0, 10:] = 0.0
            fleet.update()
        self.start, self.R = self.aircraft.state[:, 0, :3].clone(), R.to(self.aircraft.state)

    def go(self, times: int = 1) -> None:
        """Control steps of DT."""
        for _ in range(times):
            held = self.contacts.begin()
            self.slabs.model.step(self.slabs, self.around)
            self.contacts.meet(held)
            self.aircraft.model.step(self.aircraft, self.around)
            self.contacts.end()

    @property
    def way(self) -> np.ndarray:
        """[env, 3] way of the aircraft since it was put, in the axes of the slab then, m."""
        away = self.aircraft.state[:, 0, :3] - self.start
        return (self.R.mT @ away.unsqueeze(-1)).squeeze(-1).double().numpy()

    @property
    def speed(self) -> np.ndarray:
        """[env, 3] velocity in the axes of the slab as it was put, m/s."""
        return (self.R.mT @ self.aircraft.velocity_n[:, 0].unsqueeze(-1)).squeeze(-1).double().numpy()


def closed_forms(case: Case) -> None:
    """contact_closed_forms*.json: see the module."""
    data = read_json(case.path)
    craft = parameters(case, "x500", "A")
    tips = data.get("tip_over") if isinstance(data, dict) else None  # one geometry, and so one kernel, for all trials
    base = (number(tips, "half_base_longitudinal_m"), number(tips, "half_base_lateral_m")) if tips else HALF_BASE
    for key, check in (
        ("leg", _legs),
        ("block_on_tilted_deck", _blocks),
        ("sliding_stop_on_level_deck", _stops),
        ("impact_drone_boat_free_bodies", _blows),
    ):
        if isinstance(data, dict) and key in data:
            check(case, craft, base, records(data, key))
    if tips:
        _tips(case, craft, base, tips)
    if not case.checks:
        raise TableError("none of its keys is known")


def _column(rows: list[dict], key: str) -> np.ndarray:
    return np.array([number(row, key) for row in rows])


def _legs(case: Case, craft: MultirotorParams, base: Base, rows: list[dict]) -> None:
    """Sink over time from the first touch, while the contact holds."""
    trial = Trial(craft, len(rows), base)
    k, c = _column(rows, "k_N_m") / 4, _column(rows, "c_N_s_m") / 4
    trial.numbers(LOW, _column(rows, "m_kg"), k, c)
    trial.put(velocity=np.stack([0 * k, 0 * k, _column(rows, "touch_speed_m_s")], -1))
    times = sorted({float(t) for row in rows for t in row["sink_at_t"]})
    ours, theirs = [], []
    step = 0
    for t in times:
        trial.go(round(t / DT) - step)
        step = round(t / DT)
        for i, row in enumerate(rows):
            wanted = next((x for at, x in row["sink_at_t"].items() if float(at) == t), None)
            if wanted is not None and t < (row.get("lift_off_t_s") or math.inf):
                ours.append(trial.way[i, 2] / number(row, "max_sink_m"))
                theirs.append(wanted / number(row, "max_sink_m"))
    case.absolute("sink of a leg over the deepest", ours, theirs, SINK)


def _blocks(case: Case, craft: MultirotorParams, base: Base, rows: list[dict]) -> None:
    """Blocks on a tilted deck stick, once they rest, or slide at a steady acceleration."""
    mu, tilt = _column(rows, "mu"), np.radians(_column(rows, "deck_tilt_deg"))
    sticks = np.array([row["state"] == "sticks" for row in rows])
    trial = Trial(craft, len(rows), base)
    trial.numbers(LOW, friction=np.where(sticks, 10.0, mu))
    trial.put(roll=tilt, sink=craft.physical.mass * GRAVITY * np.cos(tilt) / (4 * STIFF))
    trial.go(round(0.5 / DT))
    trial.rough(mu)
    before = trial.speed[:, 1]
    trial.go(round(0.5 / DT))
    gained, rested = (trial.speed[:, 1] - before) / 0.5, trial.way[:, 1]
    trial.go(round(1.0 / DT))
    crept = trial.way[:, 1] - rested
    wanted = np.array([row.get("acceleration", 0.0) for row in rows])
    if not sticks.all():
        case.absolute(
            "acceleration down a slope, relative", gained[~sticks] / wanted[~sticks], wanted[~sticks] ** 0, SLIDE
        )
    if sticks.any():
        case.absolute("creep of what sticks, m", crept[sticks], 0 * crept[sticks], 1e-5)


def _stops(case: Case, craft: MultirotorParams, base: Base, rows: list[dict]) -> None:
    """Distance in which a block stops on a level deck; the soles spring back when it stands."""
    mu, weight = _column(rows, "mu"), craft.physical.mass * GRAVITY
    trial = Trial(craft, len(rows), base)
    trial.numbers(LOW, friction=mu)
    trial.put(sink=weight / (4 * STIFF), velocity=np.stack([_column(rows, "v0"), 0 * mu, 0 * mu], -1))
    trial.go(round(1.0 / DT))
    springs = float((mu * weight / (4 * STIFF)).max())
    case.absolute("distance to a stop, m", trial.way[:, 0], _column(rows, "distance"), 2.0 * springs)


def _tips(case: Case, craft: MultirotorParams, base: Base, given: dict) -> None:
    """The least tilt of a fan at which an aircraft that cannot slide falls over an edge."""
    low, n = number(given, "com_height_m"), len(FAN)
    wanted = np.array([number(given, "lateral_deg"), number(given, "longitudinal_deg")])
    tilt = np.radians(wanted)[:, None] + FAN
    zero = np.zeros(n)
    trial = Trial(craft, 2 * n, base)
    trial.numbers(low, stiffness=RIGID, damping=HARD, friction=10.0)
    sink = craft.physical.mass * GRAVITY * np.cos(tilt).ravel() / (4 * RIGID)
    trial.put(np.concatenate((tilt[0], zero)), np.concatenate((zero, tilt[1])), sink=sink)
    trial.go(round(2.0 / DT))  # a fall beyond the edge by half a step of the fan takes a second
    leant = (trial.R.mT @ torch_rotation_matrix(trial.aircraft.state[:, 0, 3:7]))[:, 2, 2].double().numpy()
    fallen = (leant < math.cos(0.5)).reshape(2, n)
    half = 0.5 * math.degrees(FAN[1] - FAN[0])
    ours = [
        math.degrees(row[fell.argmax()]) - half if fell.any() else 90.0 for row, fell in zip(tilt, fallen, strict=True)
    ]
    case.absolute("tilt at which it tips, deg", ours, wanted, TIP_DEG)


def _blows(case: Case, craft: MultirotorParams, base: Base, rows: list[dict]) -> None:
    """Impulses between free bodies, of the restitution that the blow shows."""
    m, M, lever = (_column(rows, key) for key in ("m_drone", "m_boat", "lever_m"))
    inertia = _column(rows, "boat_inertia_about_axis")
    down, rise = _column(rows, "drone_down_before"), _column(rows, "boat_point_down_before")
    trial = Trial(craft, len(rows), base, (1 / M, 1 / inertia))
    trial.numbers(LOW, m, STEEL / 4, 0.0, friction=0.0)
    trial.put(lever=lever, velocity=np.stack([0 * m, 0 * m, down], -1), rise=rise)
    steps = 8
    trial.go(steps)
    state = trial.slabs.state[:, 0].double().numpy()
    after = trial.speed[:, 2] - GRAVITY * DT * steps  # as without weight
    boat = trial.slabs.velocity_n[:, 0, 2].double().numpy()
    impulse = M * (boat - rise)
    point = boat - lever * state[:, 11]
    e = (point - after) / (down - rise)
    reduced = 1 / (1 / m + 1 / M + lever**2 / inertia)
    wanted = (1 + e) * reduced * (down - rise)
    for name, which, tolerance in (("central", lever == 0, BLOW), ("off centre", lever != 0, OFF_CENTRE)):
        if which.any():
            case.absolute(
                f"impulse of a blow, {name}, relative", impulse[which] / wanted[which], wanted[which] ** 0, tolerance
            )


__all__ = ["closed_forms"]
