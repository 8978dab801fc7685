"""Legs on decks: closed forms of a leg, of friction, of tipping, and what is conserved between free bodies."""

import json
import math

import numpy as np
import pytest
import torch
from folders import PLUGINS
from torch import Tensor

from taichi_sim.config import WorldConfig
from taichi_sim.kernels.conventions import GRAVITY
from taichi_sim.kernels.rotation import torch_quaternion_from_euler, torch_rotation_matrix
from taichi_sim.world import World

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("f64")]
RAFT = PLUGINS / "raft.toml"
DECK, SOLES = 0.3, 0.2288691310180355  # m: height of the raft's deck; the x500's soles below its centre of gravity
MASS, LEGS = 2.0643076923076915, 4  # kg
VACUUM = {f"rotor.{key}": 0.0 for key in ("k_d", "k_z", "k_h", "k_flap", "J_r")} | {
    "rotor.k_f": 1e-30, "rotor.k_m": 1e-30, **{f"physical.drag.{k}": 0.0 for k in range(3)}
}  # fmt: skip


def on_rafts(envs: int, interval: float = 0.02, boats: int = 1, drones: int = 1, more: bool = False) -> World:
    """x500s without thrust, without air, and rafts."""
    sea = {"hs": 1e-3, "tp": 4.0, "realisations": 1}
    raft = {"vehicle": str(RAFT), "count": boats}
    teams = {"drones": {"vehicle": "x500", "count": drones}, "boats": raft} | ({"others": raft} if more else {})
    config = WorldConfig.model_validate({"dt": 0.02, "decision_interval": interval, "sea": sea} | teams)
    world = World(config, envs)
    world.teams["drones"].set_numbers(VACUUM)
    return world


def states(position, euler=(0.0, 0.0, 0.0), velocity_b=(0.0, 0.0, 0.0), rates=(0.0, 0.0, 0.0)) -> Tensor:
    """[n, 13] of arrays that broadcast to [n, 3]."""
    parts = np.broadcast_arrays(*(np.atleast_2d(np.asarray(x, float)) for x in (position, euler, velocity_b, rates)))
    place, angles, v, w = (torch.from_numpy(part.copy()) for part in parts)
    return torch.cat((place, torch_quaternion_from_euler(*angles.unbind(-1)), v, w), dim=-1)


def put(world: World, team: str, rows: Tensor) -> None:
    """Place the vehicles of a team at states [env, 13] or [env, vehicle, 13], as they are."""
    fleet = world.teams[team]
    fleet.state.copy_(rows.reshape(fleet.state.shape))
    fleet.update()
    fleet.model.reset_aux(fleet.aux, fleet.state, world.felt(team))
    world.contacts.place(fleet, torch.arange(world.num_envs))


def go(world: World, steps: int = 1) -> None:
    for _ in range(steps):
        world.step({name: torch.zeros_like(fleet.action) for name, fleet in world.teams.items()})


def attitude(state: Tensor) -> Tensor:
    return torch_rotation_matrix(state[..., 3:7])


def rotated(R: Tensor, v: Tensor) -> Tensor:
    return (R @ v.unsqueeze(-1)).squeeze(-1)


# -- closed forms ------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def table(reference):
    """Closed forms of the reference: README there."""
    return json.loads((reference / "multirotor" / "contact_closed_forms.json").read_text())


def test_closed_forms_of_legs_friction_and_tipping(table):
    """On decks that stay: legs sink and let go, blocks stick, slide and stop, aircraft tip or do not."""
    legs, blocks, stops = table["leg"], table["block_on_tilted_deck"], table["sliding_stop_on_level_deck"]
    tips = [(axis, math.radians(table["tip_over"][name]) + away) for axis, name in
            ((0, "lateral_deg"), (1, "longitudinal_deg")) for away in (-0.03, 0.03)]  # fmt: skip
    n = [len(x) for x in (legs, blocks, stops, tips)]
    rows = np.split(np.arange(sum(n)), np.cumsum(n)[:-1])
    k, c = np.full(sum(n), 1250.0), np.full(sum(n), 25.0)
    mu, tilt, slip = np.full(sum(n), 0.5), np.zeros((sum(n), 3)), np.zeros((sum(n), 3))
    k[rows[0]], c[rows[0]] = ([leg[key] / LEGS for leg in legs] for key in ("k_N_m", "c_N_s_m"))
    slip[rows[0], 2] = [leg["touch_speed_m_s"] for leg in legs]
    mu[rows[1]], tilt[rows[1], 0] = [b["mu"] for b in blocks], [math.radians(b["deck_tilt_deg"]) for b in blocks]
    mu[rows[2]], slip[rows[2], 0] = [s["mu"] for s in stops], [s["v0"] for s in stops]
    mu[rows[3]] = 3.0
    k[rows[3]], c[rows[3]] = 20_000.0, 80.0  # what bends less leans less
    low = np.full(sum(n), SOLES)  # height of the centre of gravity over the soles
    low[np.concatenate((rows[1], rows[2]))] = 0.05  # blocks do not tip
    for row, (axis, angle) in zip(rows[3], tips, strict=True):
        tilt[row, axis] = angle
    world = on_rafts(sum(n))
    boats, drones = world.teams["boats"], world.teams["drones"]
    rough = np.where(np.isin(np.arange(sum(n)), rows[1]) & (tilt[:, 0] < np.arctan(mu)), 3.0, mu)
    boats.set_numbers({"mass": 0.0, "deck.friction": rough[:, None]})  # what is to stick comes to rest first
    drones.set_numbers(
        {"legs.stiffness": k[:, None], "legs.damping": c[:, None], "physical.cg.2": 0.227 - low[:, None]}
    )
    put(world, "boats", states((0.0, 0.0, 0.0), tilt))
    pressed = MASS * GRAVITY * np.cos(tilt[:, 0]) * np.cos(tilt[:, 1]) / (LEGS * k)
    pressed[rows[0]] = 0.0
    R = attitude(boats.state[:, 0])
    place = rotated(R, torch.tensor(np.stack([0 * k - 0.5, 0 * k, pressed - DECK - low], axis=1)))
    put(world, "drones", states(place.numpy(), tilt, slip))
    seen = []
    for step in range(150):
        if step == 50:
            boats.set_numbers({"deck.friction": mu[:, None]})
        go(world)
        seen.append(
            torch.cat((rotated(R.mT, drones.state[:, 0, :3] - place), rotated(R.mT, drones.velocity_n[:, 0])), -1)
        )
    way = torch.stack(seen).numpy()  # [step, env, 6] in the deck's axes

    def at(t, row):
        return way[round(t / 0.02) - 1, row]

    for row, leg in zip(rows[0], legs, strict=True):
        for t, sink in leg["sink_at_t"].items():
            if float(t) in (0.02, 0.1, 0.2, 0.5) and float(t) < (leg["lift_off_t_s"] or math.inf):
                assert at(float(t), row)[2] == pytest.approx(sink, abs=0.01 * leg["max_sink_m"]), (row, t)
    for row, block in zip(rows[1], blocks, strict=True):
        if block["state"] == "sticks":
            bends = block["tangential_load_N"] / (LEGS * k[row]) * (1.0 + (0.05 / 0.132) ** 2)  # and leans
            assert bends < at(1.0, row)[1] < 1.5 * bends
            assert at(3.0, row)[1] == pytest.approx(at(1.0, row)[1], abs=0.2 * bends)
            assert np.abs(way[125:, row, 1] - at(3.0, row)[1]).max() < 1e-8, "no creep"
        else:
            assert at(1.0, row)[4] - at(0.5, row)[4] == pytest.approx(0.5 * block["acceleration"], rel=0.005)
    for row, stop in zip(rows[2], stops, strict=True):
        springs = stop["mu"] * MASS * GRAVITY / (LEGS * k[row])  # back, once it stands
        assert at(1.0, row)[0] == pytest.approx(stop["distance"], abs=1.5 * springs)
        assert np.abs(at(3.0, row)[3:]).max() < 1e-6
    leant = attitude(drones.state[:, 0])[rows[3]].mT @ R[rows[3]]
    assert list(leant[:, 2, 2] < 0.9) == [False, True, False, True]
    assert drones.touch is not None
    struck = drones.model.endings(drones, world)["struck"][:, 0]
    go(world, 50)
    struck |= drones.model.endings(drones, world)["struck"][:, 0]
    assert struck[rows[3]].tolist() == [False, True, False, True]
    assert not struck[: rows[3][0]].any()


# -- what is conserved -------------------------------------------------------------------------------------------------


def mechanics(world: World) -> tuple[Tensor, Tensor, Tensor]:
    """Linear and angular momentum [env, 3] about the origin of all, and mechanical energy [env]."""
    P = H = torch.zeros((world.num_envs, 3), dtype=torch.float64)
    E = torch.zeros(world.num_envs, dtype=torch.float64)
    for name, fleet in world.teams.items():
        model = fleet.model
        mass = fleet.vary["mass" if name != "drones" else "physical.mass"]
        J = model.params.physical.inertia if name == "drones" else np.diag(model.params.inertia)
        J = torch.tensor(J, dtype=torch.float64)
        R, state = attitude(fleet.state), fleet.state
        v, h = rotated(R, state[..., 7:10]), rotated(R @ J, state[..., 10:])
        p = mass.unsqueeze(-1) * v
        P, H = P + p.sum(1), H + (torch.linalg.cross(state[..., :3], p) + h).sum(1)
        E = E + 0.5 * ((p * v).sum(-1) + (rotated(R @ J, state[..., 10:]) * rotated(R, state[..., 10:])).sum(-1)).sum(1)
    drones, boats = world.teams["drones"], world.teams["boats"]
    E = E - MASS * GRAVITY * drones.state[..., 2].sum(1)
    points = drones.model.soles(drones)[:, 0]
    for i in range(drones.count):  # springs, of soles that are down on the first boat
        soles = drones.state[:, i, None, :3] + rotated(attitude(drones.state[:, i])[:, None], points)
        R_D = attitude(boats.state[:, 0])[:, None]
        d = rotated(R_D.mT, soles - boats.state[:, :1, :3]) + torch.tensor([0.0, 0.0, DECK])
        memory = drones.touch.soles[:, i].unflatten(-1, (LEGS, 3))
        down = memory[..., 2] > 0.5
        bent = (d[..., :2] - memory[..., :2]).square().sum(-1)
        k = drones.vary["legs.stiffness"][:, i, None]
        E = E + (0.5 * k * down * (d[..., 2].clamp(min=0).square() + bent)).sum(-1)
    return P, H, E


@pytest.mark.parametrize("interval", [0.02, pytest.param(0.1, marks=pytest.mark.slow)])
def test_free_bodies_keep_their_momentum_and_gain_no_energy(interval):
    """Touchdowns off the middle, askew, spinning and sliding, on rafts that rise, drift and turn.

    Aircraft do not tumble: fast turning costs the flight's own Runge-Kutta step more than contact does.
    """
    rng, n, T = np.random.default_rng(5), 24, 1.0
    world = on_rafts(n, interval)
    boats, drones = world.teams["boats"], world.teams["drones"]
    boats.set_numbers({"mass": 55.0, "deck.friction": rng.uniform(0.0, 0.6, (n, 1))})
    drones.set_numbers({"legs.damping": rng.uniform(5.0, 30.0, (n, 1))})
    one, three = (n, 3), (-1.0, 1.0)
    velocity = rng.uniform(*three, one) * (0.6, 0.6, 0.4) + (0.0, 0.0, 0.2)
    rates, turn = 0.3 * rng.uniform(*three, one), 0.08 * rng.uniform(*three, one)
    put(world, "boats", states((0.0, 0.0, 0.0), turn, velocity, rates))
    place = rng.uniform(*three, one) * (0.7, 0.7, 0.02) - (0.0, 0.0, DECK + SOLES + 0.2)
    meeting = velocity + rng.uniform(*three, one) * (0.2, 0.2, 0.15) + (0.0, 0.0, 0.5)
    put(world, "drones", states(place, turn + 0.04 * rng.uniform(*three, one), meeting, 0.2 * rng.uniform(*three, one)))
    P0, H0, E0 = mechanics(world)
    scale = 55.0 * torch.tensor(velocity).norm(dim=-1) + MASS * torch.tensor(meeting).norm(dim=-1)
    last, torque, touched, grown = E0, torch.zeros_like(H0), torch.zeros(n, dtype=torch.bool), 0.0
    weight = torch.tensor([0.0, 0.0, MASS * GRAVITY], dtype=torch.float64)
    for _ in range(round(T / interval)):
        x0, v0 = drones.state[:, 0, :3].clone(), drones.velocity_n[:, 0].clone()
        go(world)
        x1, v1 = drones.state[:, 0, :3], drones.velocity_n[:, 0]
        middle = 0.5 * interval * (x0 + x1) + interval**2 / 12 * (v0 - v1)  # of the way, times the interval
        torque += torch.linalg.cross(middle, weight.expand(n, 3))
        touched |= drones.touch.on[:, 0]
        E = mechanics(world)[2]
        grown, last = max(grown, float((E - last).max())), E
    P, H, E = mechanics(world)
    off_P, off_H = (P - P0 - T * weight).norm(dim=-1) / scale, (H - H0 - torque).abs() / scale.unsqueeze(-1)
    assert touched.all() and float(drones.angular_velocity_b.abs().max()) < 6.0
    assert float(off_P.max()) < 1e-6
    assert float(off_H[:, 2].max()) < 1e-6
    if interval == 0.02:  # the moment of the weight is known well enough
        assert float(off_H.max()) < 2e-6
    assert grown < 1e-6 * float(E0.abs().max())
    assert float((E0 - E).min()) > 0.1, "most of the speed of the meeting is gone"
