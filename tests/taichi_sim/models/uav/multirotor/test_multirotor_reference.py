"""The x500 against an independent code's tables: derivatives, flights, trims, ground effect; and exact lags."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from taichi_sim.bench import Bench
from taichi_sim.models.catalogue import load_vehicle
from taichi_sim.models.uav.multirotor.trim import trim
from tests.probes import ground_ratios, rotor_rates

STATE = ("n", "e", "d", "e0", "e1", "e2", "e3", "u", "v", "w", "p", "q", "r")
ROTORS = range(1, 5)
PLAIN = {"J_r": 0.0, "k_z": 0.0}  # rotors of the tables have no angular momentum
VARIANTS = {
    "A": (PLAIN | {"k_d": 0.0}, [0.0, 0.0, 0.0]),
    "B": (PLAIN, [0.0, 0.0, 0.0]),
    "C": (PLAIN | {"k_z": 0.00016, "k_h": 0.005, "k_flap": 5e-6}, [0.02, 0.02, 0.04]),
}


def x500(variant, dt=0.005, substeps=1, **lags):
    """The shipped x500 as a variant of the tables, flown by its rotors, far from any ground."""
    rotor, drag = VARIANTS[variant]
    return load_vehicle(
        "x500", dt, substeps, rotor=rotor | lags, physical={"drag": drag}, ground_effect=False,
        control={"actions": "rotors", "speed": 5.0, "max_tilt_deg": 70.0},
        envelope={"airspeed": 5.0, "max_airspeed": 5.0},
    )  # fmt: skip


@pytest.fixture(scope="module")
def table(columns):
    """A table's columns by name, without units."""
    return lambda name: SimpleNamespace(
        **{key.split("[")[0]: value for key, value in vars(columns(f"multirotor/{name}.csv")).items()}
    )


def rows(table, names):
    """Columns side by side [row, n]."""
    return np.stack([getattr(table, name) for name in names], axis=1)


@pytest.mark.parametrize("variant", VARIANTS)
def test_derivatives_at_random_states(variant, precision, table):
    """Of the state, and of the rotors' speeds toward commands beyond their range."""
    given, model = table(f"x500_rhs_samples_{variant}"), x500(variant)
    speeds, commands = rows(given, [f"om{k}" for k in ROTORS]), rows(given, [f"cmd{k}" for k in ROTORS])
    ours = np.hstack(
        (
            model.rhs(rows(given, STATE), speeds, wind=rows(given, ("wn", "we", "wd"))),
            rotor_rates(model.p, speeds, commands),
        )
    )
    theirs = rows(given, [f"d_{name}" for name in (*STATE, *(f"om{k}" for k in ROTORS))])
    tolerance = {"f64": 2e-11, "f32": 2e-5}[precision]  # the table has 12 digits
    assert (np.abs(ours - theirs) / (1 + np.abs(theirs))).max() < tolerance
    assert np.abs(theirs).max(axis=0).min() > 1.0


@pytest.mark.usefixtures("f64")
@pytest.mark.parametrize(
    ("name", "metres", "degrees"),
    [
        ("hover_drop_A", 6e-3, 1e-6),  # Runge-Kutta of the lag: 0.14 m, and 17 rad/s in the rotors
        ("yaw_doublet_A", 2e-4, 1e-3),
        ("pitch_doublet_B", 5e-4, 4e-3),
        ("forward5_wind8_C", 3e-4, 2e-3),
    ],
)
def test_seconds_of_flight_at_a_step_of_a_fiftieth(name, metres, degrees, table):
    """A step longer than the rotors' time constant: they are exact, the flight right to RK4's error."""
    given = table(f"x500_{name}_converged")
    interval = given.t[1] - given.t[0]
    model = x500(name[-1], 0.02, round(interval / 0.02))
    commands, states = rows(given, [f"cmd{k}" for k in ROTORS]), rows(given, STATE)
    team = Bench(model)
    team.wind[:] = torch.tensor([given.wn[0], given.we[0], given.wd[0]])
    team.state[0, 0] = torch.tensor(states[0])
    model.reset_aux(team.aux, team.state, team.around)
    team.aux[0, 0, -4:] = torch.tensor(rows(given, [f"om{k}" for k in ROTORS])[0])
    ours, speeds = [], []
    for action in model.action(torch.tensor(commands)):
        ours.append(team.state[0, 0].numpy().copy())
        speeds.append(team.aux[0, 0, -4:].numpy().copy())
        team.step(action)
    ours = np.array(ours)
    same = np.sign(np.sum(ours[:, 3:7] * states[:, 3:7], axis=1))[:, None]
    turned = 2 * np.linalg.norm(ours[:, 3:7] - same * states[:, 3:7], axis=1)
    assert np.abs(ours[:, :3] - states[:, :3]).max() < metres
    assert np.rad2deg(turned.max()) < degrees
    assert np.abs(np.array(speeds) - rows(given, [f"om{k}" for k in ROTORS])).max() < 2e-3  # the table's own error
    assert given.t[-1] >= 4.0


@pytest.mark.usefixtures("f64")
def test_trims_in_wind(reference):
    for name, given in json.loads((reference / "multirotor" / "trims.json").read_text()).items():
        ours = trim(x500(name[-1]).p, given["ground_velocity_NED"], given["wind_NED"], given["heading"])
        assert (ours.phi, ours.theta) == pytest.approx((given["phi"], given["theta"]), abs=1e-12)
        assert ours.omega == pytest.approx(given["rotor_speeds"], rel=1e-12)


@pytest.mark.usefixtures("f64")
def test_hover_and_its_linear_model(reference):
    """Rotor speed, induced velocity; decay, accelerations of a mix of rotors, unstable pair of variant B."""
    from taichi_sim.models.uav.multirotor.trim import linear_modes

    given = json.loads((reference / "multirotor" / "closed_forms_x500.json").read_text())
    model = x500("B")
    assert model.allocation.hover == pytest.approx([given["hover"]["omega"]] * 4)
    assert model.induced == pytest.approx(given["hover"]["disc_induced_velocity_rho1_225"])
    linear, small = linear_modes(model.p, trim(model.p)), given["small_motion_rates_at_hover"]
    assert -linear.A[0, 0] == pytest.approx(small["horizontal_velocity_decay_1_s"], rel=1e-6)
    assert linear.A[4, 0] == pytest.approx(small["pitch_acc_per_m_s_headwind"], rel=1e-6)
    assert linear.B[3] @ [-1, 1, 1, -1] == pytest.approx(small["roll_acc_per_rad_s_of_mix"], rel=1e-6)
    assert linear.B[5] @ [1, 1, -1, -1] == pytest.approx(small["yaw_acc_per_rad_s_of_mix"], rel=1e-6)
    pair = next(mode for mode in linear.modes if mode.name == "pitch" and mode.oscillates)
    assert pair.eigenvalues[0] == pytest.approx(complex(*given["open_loop_modes_at_hover_variant_B"]["eigenvalues"][1]))


@pytest.mark.usefixtures("f64")
def test_ground_effect_of_one_rotor_and_of_four(table):
    """Cheeseman & Bennett's formula, and images of all four, at 0.5 to 10 radii."""
    given, p = table("ground_effect_x500"), x500("A").p
    one = p.model_copy(update={"rotors": p.rotors[:1]})
    for craft, theirs in ((one, given.CB_single), (p, given.images_quad_Kb0)):
        heights = np.repeat(given.z[:, None], len(craft.rotors), axis=1)
        assert ground_ratios(craft, heights, 1.0, 770.0) == pytest.approx(
            np.repeat(theirs[:, None], len(craft.rotors), axis=1), rel=1e-10
        )


@pytest.mark.usefixtures("f64")
@pytest.mark.parametrize("dt", [0.002, 0.02, 0.1])
def test_lags_are_exact_at_any_step(dt):
    """omega_c + (omega - omega_c) e^(-t / tau), up by one time constant and down by the other."""
    tau = {"tau_up": 0.0125, "tau_down": 0.07}
    model = x500("A", dt, round(0.1 / dt), **tau)
    team = Bench(model).put()
    start = team.aux[0, 0, -4:].numpy().copy()
    command = np.array([900.0, 500.0, 1000.0, 0.0])
    team.step(model.action(torch.tensor(command)), 2)
    constants = np.where(command > start, tau["tau_up"], tau["tau_down"])
    expected = command + (start - command) * np.exp(-0.2 / constants)
    assert team.aux[0, 0, -4:].numpy() == pytest.approx(expected, rel=1e-12)
