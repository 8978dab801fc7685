"""Aircraft on hulls in waves: they ride without creeping, and what they remember is restored; who meets whom."""

import math

import numpy as np
import pytest
import torch
from folders import PLUGINS
from torch import Tensor

from taichi_sim.config import WorldConfig
from taichi_sim.kernels.rotation import torch_euler_from_quaternion, torch_quaternion_from_euler, torch_rotation_matrix
from taichi_sim.models.contact.between_teams import PlacementError
from taichi_sim.world import World
from tests.probes import ground_ratios

pytestmark = pytest.mark.slow

RAFT = PLUGINS / "raft.toml"
SOLES = 0.2288691310180355  # m, the x500's below its centre of gravity
COMPONENTS = 16  # of every sea here, and every aircraft's numbers are given: one kernel serves all
GYRO = {"rotor.J_r": 0.0}
IDLE = {
    "rotor.k_f": 1e-30,
    "rotor.k_m": 1e-30,
    "rotor.J_r": 0.0,
    "rotor.k_d": 0.0,
    "rotor.k_z": 0.0,
}  # what its controller wants moves nothing


def sea_state_5(envs: int, vehicle: str = "wamv", seed: int = 1) -> World:
    """Boats at rest in a seaway, an x500 over each deck, its soles 2 cm above it."""
    teams = {"boats": {"vehicle": vehicle, "count": 1}, "drones": {"vehicle": "x500", "count": 1}}
    sea = {"sea_state": 5, "components": COMPONENTS, "realisations": envs}
    world = World(WorldConfig.model_validate({"sea": sea, "seed": seed} | teams), envs)
    boats, everywhere = world.teams["boats"], torch.arange(envs)
    state = torch.zeros_like(boats.state)
    state[..., 3] = 1.0
    world.place("boats", everywhere, state)
    world.teams["drones"].set_numbers(IDLE)
    over(world, (0.0, 0.0, 0.02))
    return world


def over(world: World, away: tuple[float, float, float], carrier: str = "boats", which: int = 0) -> None:
    """Put aircraft over the middle of a deck, in its axes, moving with it, `away` (m): ahead, right, up."""
    boats, drones = world.teams[carrier], world.teams["drones"]
    assert boats.model.deck is not None
    one = boats.state[:, which : which + 1].double()
    R = torch_rotation_matrix(one[..., 3:7])
    x, y, z = boats.model.deck.centre
    r = one.new_tensor((x + away[0], y + away[1], z - SOLES - away[2]))
    state = drones.state.double().clone()
    state[..., :3] = one[..., :3] + (R @ r).expand(drones.state.shape[:2] + (3,))
    state[..., 3:7], state[..., 10:] = one[..., 3:7], one[..., 10:]
    state[..., 7:10] = one[..., 7:10] + torch.linalg.cross(one[..., 10:], r.expand(one[..., 10:].shape))
    drones.state.copy_(state)
    drones.update()
    drones.model.reset_aux(drones.aux, drones.state, world.felt("drones"))
    world.contacts.place(drones, torch.arange(world.num_envs))


def go(world: World, steps: int = 1) -> None:
    for _ in range(steps):
        world.step({name: torch.zeros_like(fleet.action) for name, fleet in world.teams.items()})


def on_deck(world: World) -> Tensor:
    """Where aircraft are on the boats [env, 3], m, and their heading there [env], rad."""
    boat, drone = world.teams["boats"].state[:, 0].double(), world.teams["drones"].state[:, 0].double()
    R = torch_rotation_matrix(boat[:, 3:7])
    place = (R.mT @ (drone[:, :3] - boat[:, :3]).unsqueeze(-1)).squeeze(-1)
    turn = (R.mT @ torch_rotation_matrix(drone[:, 3:7]))[:, 1, 0]
    return torch.cat((place, turn.unsqueeze(-1)), dim=-1)


@pytest.mark.parametrize("vehicle", ["wamv", "otter"])
def test_it_rides_in_sea_state_5_and_does_not_creep(vehicle, seconds=3600.0):
    """In single precision, far from the origin at the end: it stays within what its legs bend."""
    world = sea_state_5(4, vehicle)
    go(world, 50)
    first, most, steepest = on_deck(world), 0.0, 0.0
    for _ in range(round(seconds)):
        go(world, 10)
        most = max(most, float((on_deck(world) - first).abs().max()))
        tilt = torch_euler_from_quaternion(world.teams["boats"].quaternion_nb)[..., :2].abs().max()
        steepest = max(steepest, float(tilt))
    late = on_deck(world) - first
    far = float(world.teams["boats"].position_n.abs().max())
    print(
        f"{vehicle}, {seconds:g} s: moved {most:.2g} m at most, {float(late.abs().max()):.2g} at the end; tilt up to "
    )
    print(f"{math.degrees(steepest):.3g} deg, {far:.3g} m from the origin")
    drones = world.teams["drones"]
    assert drones.touch is not None and drones.touch.on.all()
    assert not any(ended.any() for ended in drones.model.endings(drones, world).values())
    assert math.degrees(steepest) > 5.0
    assert most < 0.010  # the worst moment of an hour: 2.5 to 6.4 mm in twelve other hours
    assert float(late[:, [0, 1, 3]].abs().max()) < 0.004


@pytest.mark.slow  # one more world to compile
def test_a_touchdown_is_restored_copied_and_forked_to_the_bit():
    """At the touch and while it rides: vehicles, what soles remember, what presses."""

    def everything(of: World) -> Tensor:
        drones = of.teams["drones"]
        assert drones.touch is not None
        parts = (of.teams["boats"].state, drones.state, drones.touch.pressing, drones.touch.soles)
        return torch.cat([part.flatten(1) for part in parts], dim=1).clone()

    world = sea_state_5(3)
    for steps in (0, 1, 10):
        go(world, steps)
        saved, fork = world.snapshot(), world.fork([2, 0], 2)
        seen = []
        for _ in range(2):
            go(world, 8)
            seen.append(everything(world))
            world.restore(saved)
        go(fork, 8)
        assert seen[0].equal(seen[1]) and seen[0][[2, 2, 0, 0]].equal(everything(fork))
    world.copy([1], [2])
    go(world, 8)
    assert everything(world)[1].equal(everything(world)[2])
    again = sea_state_5(3)
    go(again, 11)
    assert not again.teams["drones"].touch.soles.equal(world.teams["drones"].touch.soles)  # type: ignore[union-attr]


def test_what_happens_on_one_deck_is_nothing_to_other_environments():
    """To the bit, whether a contact is going on elsewhere or not; nor is a deck to an aircraft far from it."""
    one, other = sea_state_5(2), sea_state_5(2)
    for world in (one, other):
        drones = world.teams["drones"]
        drones.state[1, 0, 2] -= 30.0
        drones.state[0, 0, 2] -= 30.0 if world is other else 0.0
        drones.update()
        go(world, 10)
    assert one.teams["drones"].touch.on.flatten().tolist() == [True, False]  # type: ignore[union-attr]
    for name in ("boats", "drones"):
        assert one.teams[name].state[1].equal(other.teams[name].state[1])
        assert not one.teams[name].state[0].equal(other.teams[name].state[0])


def rafts(envs: int, boats: int = 1, drones: int = 1) -> World:
    """x500s that fly, rafts, and other rafts 20 m to the right, none of which anything moves, all level."""
    raft = {"vehicle": str(RAFT), "count": boats}
    sea = {"hs": 1e-3, "tp": 4.0, "components": COMPONENTS, "realisations": 1}
    flyers = {"vehicle": "x500", "count": drones}
    world = World(WorldConfig.model_validate({"sea": sea, "drones": flyers, "boats": raft, "others": raft}), envs)
    for name, right in (("boats", 0.0), ("others", 20.0)):
        fleet = world.teams[name]
        fleet.set_numbers({"mass": 0.0})
        fleet.state[..., 2] = -5.0
        fleet.state[..., 1] = right + 5.0 * torch.arange(boats)
        fleet.update()
    return world


def test_any_aircraft_stands_on_any_deck_of_its_environment():
    """Two teams of two rafts, two aircraft on three of the decks; each presses on its own and on no other."""
    world = rafts(2, 2, 2)
    for name in ("boats", "others"):
        world.teams[name].set_numbers({"mass": [[50.0, 50.0], [0.0, 0.0]]})
    drones = world.teams["drones"]
    drones.set_numbers(IDLE)
    over(world, (0.5, 0.0, 0.0), "others", 1)
    drones.state[:, 0] = drones.state[:, 1]
    drones.state[0, 0, 1] -= 25.0 - 5.0  # in environment 0 the first one stands on the first team's second raft
    drones.state[1, 0, 0] -= 1.0  # in environment 1 both stand on one
    drones.update()
    world.contacts.place(drones, torch.arange(2))
    go(world, 10)
    assert drones.touch is not None
    assert drones.touch.pressing[..., 0].tolist() == [[2.0, 4.0], [4.0, 4.0]]
    moved = [world.teams[name].velocity_n[0, :, 2].tolist() for name in ("boats", "others")]
    assert moved[0][0] == moved[1][0] == 0.0
    assert moved[0][1] == pytest.approx(moved[1][1], rel=1e-3) and moved[0][1] > 0.3
    weight = drones.touch.pressing[1, :, 3]
    assert weight.tolist() == pytest.approx([2.0643 * 9.81] * 2, rel=0.02)
    world.place("others", torch.tensor([1]), world.teams["others"].state[1:].clone())
    assert drones.touch.pressing[..., 0].tolist() == [[2.0, 4.0], [0.0, 0.0]]


def test_soles_from_below_and_beside_a_deck_do_not_stand_on_it():
    """An aircraft that comes in below a deck's plane is not lifted; over its edge it falls."""
    world = rafts(2)
    drones = world.teams["drones"]
    drones.set_numbers(IDLE)
    over(world, (0.0, 0.0, 0.0))
    drones.state[0, 0, :3] += torch.tensor([2.0, 0.0, 0.1])  # soles 10 cm below the deck's plane, beside it
    drones.state[0, 0, 7] = -3.0
    drones.state[1, 0, 0] += 1.2
    drones.state[1, 0, 7] = 3.0  # slides off
    drones.update()
    world.contacts.place(drones, torch.arange(2))
    go(world, 1)
    assert drones.touch is not None
    assert drones.touch.on[:, 0].tolist() == [False, True]
    go(world, 4)
    assert not drones.touch.on.any()
    assert drones.velocity_n[0, 0, 2].item() == pytest.approx(0.5 * 9.81, rel=0.04)  # but for drag
    assert drones.position_n[1, 0, 2] > -5.0


def test_the_ground_effect_over_a_deck_fades_at_its_edge():
    """In hover over the middle the images of a ground at the rotors' height, over the edge half of it, beside none."""
    world = rafts(4)
    drones = world.teams["drones"]
    drones.set_numbers(GYRO)
    over(world, (0.0, 0.0, 0.10))
    for row, ahead in enumerate((0.0, 0.0, 1.5, 4.0)):
        drones.state[row, 0, 0] += ahead
    drones.state[1, 0, 2] -= 0.3
    drones.update()
    world.contacts.place(drones, torch.arange(4))
    go(world, 1)
    found = drones.reading("ground_effect")[:, 0]
    height = -5.3 - drones.position_n[:, 0, 2].numpy() + 0.06 - 0.001869
    craft = drones.model.params
    speeds = np.full(4, 550.0)
    for row in range(2):
        wanted = ground_ratios(craft, np.full(4, height[row]), 1.0, speeds).mean()
        assert found[row].item() == pytest.approx(wanted, rel=0.004)
    assert found[0] > found[1] > 1.005
    assert 1.0 + 0.3 * (found[0] - 1) < found[2] < 1.0 + 0.7 * (found[0] - 1)
    assert found[3] == 1.0


def test_a_rotor_that_meets_a_deck_and_a_start_inside_one_are_told():
    world = rafts(2)
    drones = world.teams["drones"]
    drones.set_numbers(GYRO)
    over(world, (0.0, 0.0, 1.0))
    drones.state[1, 0, 2] += 1.0 + SOLES - 0.25
    angle = torch.tensor([math.radians(80.0)])
    drones.state[1, 0, 3:7] = torch_quaternion_from_euler(angle, 0 * angle, 0 * angle)[0]
    drones.update()
    go(world, 1)
    ended = drones.model.endings(drones, world)
    assert ended["struck"][:, 0].tolist() == [False, True] and not ended["ditched"].any()
    over(world, (0.0, 0.0, -0.1))
    told = (
        r"drones: vehicle 0 in environment 0 begins inside the deck of vehicle 0 of boats: its soles are 0\.1 m below"
    )
    with pytest.raises(PlacementError, match=told + r" the deck's plane, allowed are 0\.02 m"):
        go(world, 1)
