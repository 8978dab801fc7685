"""Radiation memory: a passive system, stepped as exactly as its equations, and a hull that moves by it."""

import numpy as np
import pytest
import taichi as ti
import torch

from taichi_sim.config import ConfigError
from taichi_sim.config.io import config_folder
from taichi_sim.kernels.conventions import GRAVITY
from taichi_sim.kernels.lanes import laned, laned1, laned3
from taichi_sim.models.usv.hull.database import HydroDatabase
from taichi_sim.models.usv.hull.radiation import Bank, radiate
from taichi_sim.models.usv.hull.radiation_memory import Memory
from taichi_sim.surroundings.sea import Sea
from taichi_sim.surroundings.sea.spectrum import Components

pytestmark = pytest.mark.usefixtures("f64")

BARGE = config_folder() / "vehicles" / "barge.hydro.json"
NONE = (0.0,) * 6
POTENTIAL = {"radiation": "memory", "database": BARGE.name, "linear": NONE, "quadratic": NONE}  # nothing but radiation
DT = 0.02


@pytest.fixture(scope="module")
def database() -> HydroDatabase:
    return HydroDatabase.read(BARGE)


@pytest.fixture(scope="module")
def barge(make_model):
    return make_model("barge", hydrodynamics=POTENTIAL, thrusters=None)


@pytest.fixture(scope="module")
def coupled() -> Memory:
    """Three masses that are coupled by dampers, shaken by heave, pitch and surge."""
    L = np.array([[0.9, 0, 0], [0.2, 1.1, 0], [-0.3, 0.1, 0.7]])
    G = np.array([[0.5, 0, 1.0, 0, -0.2, 0], [0.1, 0, -0.4, 0, 0.8, 0], [0, 0, 0.6, 0, 0.3, 0]])
    return Memory([1.5, 2.5, 4.0], L @ L.T, G)


def driven(memory: Memory, nu: np.ndarray, dt: float) -> np.ndarray:
    """Loads [step, run, 6] under velocities nu [step, run, 6], each in the middle of a step, from rest."""
    bank = Bank.of(memory.modes, dt)

    @ti.kernel
    def run(
        out: ti.types.ndarray(ndim=3),
        nu: ti.types.ndarray(ndim=3),
        aux: laned3,
        numbers: laned1,
    ):
        for r in range(nu.shape[1]):
            for n in range(nu.shape[0]):
                load = radiate(bank, numbers, aux, r, 0, 0, ti.Vector([nu[n, r, c] for c in range(6)]))
                for c in ti.static(range(6)):
                    out[n, r, c] = load[c]

    given = torch.from_numpy(np.ascontiguousarray(nu))
    out, aux = torch.zeros_like(given), torch.zeros((nu.shape[1], 1, bank.size), dtype=torch.float64)
    run(out, given, laned(aux), laned(torch.from_numpy(bank.numbers)))
    return out.numpy()


def test_its_modes_are_the_same_system(coupled):
    omega = np.geomspace(0.1, 30, 40)
    s, modes = 1j * omega[:, None], coupled.modes
    halves = [
        np.einsum("nf,fi,fj->nij", 1 / (s - p), c, b)
        for p, b, c in ((modes.pole, modes.enters, modes.leaves), (z.conj() for z in modes))
    ]
    assert np.allclose(0.5 * sum(halves), coupled.transfer(omega), atol=1e-12)
    assert np.allclose(coupled.kernel(0.0)[0], coupled.shape.T @ coupled.shape, atol=1e-12)
    t = np.linspace(0, 40, 40001)  # and its kernel is the transform of the damping, by Filon's short steps
    K = coupled.kernel(t)[:, 2, 2]
    assert np.trapezoid(K * np.cos(2.0 * t), t) == pytest.approx(coupled.damps(2.0)[0, 2, 2], abs=1e-6)
    assert np.trapezoid(K, t) == pytest.approx(0.0, abs=1e-6)  # slow motion makes no waves


def test_a_steady_oscillation_meets_its_damping_and_added_mass(coupled):
    omega, dt = 2.0, 0.01
    t = (np.arange(8000) + 0.5) * dt
    nu = np.zeros((len(t), 1, 6))
    nu[:, 0, 2] = np.cos(omega * t)
    load = driven(coupled, nu, dt)[4000:, 0]
    basis = np.stack([np.cos(omega * t[4000:]), np.sin(omega * t[4000:])], 1)
    (B, wA) = -np.linalg.lstsq(basis, load[:, [2, 4]], rcond=None)[0]
    assert pytest.approx(coupled.damps(omega)[0, 2, [2, 4]], abs=1e-4) == B
    assert pytest.approx(-omega * coupled.adds(omega)[0, 2, [2, 4]], abs=1e-4) == wA


def test_radiation_never_gives_work(coupled, database):
    """1,000 random motions that begin at rest: the work done on the water is never negative, at any time."""
    assert database.memory is not None
    draw = np.random.default_rng(0)
    for memory, dt in ((coupled, 0.05), (database.memory, DT)):
        scale = 1 / np.sqrt(np.maximum((memory.shape**2).sum(0), 1e-12))
        rough = draw.standard_normal((400, 1000, 6)) * (draw.random((1, 1000, 6)) < 0.5)
        smooth = np.cumsum(rough, axis=0) * dt + rough * draw.random((1, 1000, 1))
        nu = smooth * np.where((memory.shape**2).sum(0) > 0, scale, 1.0)
        work = -np.cumsum((driven(memory, nu, dt) * nu).sum(-1), axis=0) * dt
        assert work.min() >= -1e-9 * work.max()
        assert (work[-1] > 0).mean() > 0.8  # the others do not move where there is memory


def test_the_shipped_fit_has_what_it_was_fitted_to(database):
    """Every mode's damping within 8 % of its largest, added mass within 5 %; never negative, nor slow damping."""
    assert database.memory is not None and database.memory_inf is not None
    B = database.memory.damps(database.omega) - database.damping
    A = database.memory.adds(database.omega) + database.memory_inf - database.added_mass
    for mode in range(6):
        assert np.abs(B[:, mode, mode]).max() < 0.08 * database.damping[:, mode, mode].max()
        assert np.abs(A[:, mode, mode]).max() < 0.05 * database.added_mass[:, mode, mode].max()
    K = database.memory.transfer(np.geomspace(1e-3, 1e3, 500))
    assert np.linalg.eigvalsh(K + K.conj().swapaxes(1, 2)).min() > -1e-9 * np.abs(K).max()


def exact_decay(model, mode: int, time: np.ndarray) -> np.ndarray:
    """Pose in `mode` [time] of the linear hull with its memory, from a pose of 1 at rest: by eigenvalues."""
    memory, M = model.radiation.memory, model.params.M_rb + model.radiation.inertia
    n, C = len(memory), np.zeros((6, 6))
    C[2:5, 2:5] = model.geometry.hydrostatics.stiffness(model.geometry.hydrostatics.equilibrium)
    A = np.zeros((12 + 2 * n, 12 + 2 * n))  # pose, nu, masses' places and velocities
    A[:6, 6:12] = np.eye(6)
    A[6:12, :6], A[6:12, 12 + n :] = -np.linalg.solve(M, C), -np.linalg.solve(M, memory.shape.T)
    A[12 : 12 + n, 12 + n :] = np.eye(n)
    A[12 + n :, 12 : 12 + n], A[12 + n :, 12 + n :] = -np.diag(memory.frequency**2), -memory.damping
    A[12 + n :, 6:12] = memory.shape
    value, vector = np.linalg.eig(A)
    share = np.linalg.solve(vector, np.eye(len(A))[mode])
    return ((vector[mode] * share) * np.exp(np.outer(time, value))).sum(1).real


@pytest.mark.parametrize(("mode", "size", "seconds"), [(2, 1e-3, 15.0), (3, 1e-3, 60.0)])
def test_free_decay_is_the_exact_solution_with_that_memory(mode, size, seconds, barge, bench):
    team = bench(barge, envs=1)
    rest = barge.geometry.hydrostatics.equilibrium
    team.put(position=(0, 0, rest[0] + (size if mode == 2 else 0)), euler=(size if mode == 3 else 0.0, 0, 0))
    steps, found = round(seconds / DT), []
    for _ in range(steps):
        motion = team.step([0.0, 0.0]).read()
        found.append((motion.position[0, 2] - rest[0]) if mode == 2 else motion.euler[0, 0])
    time = DT * np.arange(1, steps + 1)
    exact, found = size * exact_decay(barge, mode, time), np.array(found)

    def peaks(x):
        at = np.flatnonzero((x[1:-1] > x[:-2]) & (x[1:-1] >= x[2:])) + 1
        a, b, c = x[at - 1], x[at], x[at + 1]  # of a parabola through three
        shift = 0.5 * (a - c) / (a - 2 * b + c)
        return time[at] + shift * DT, b - 0.25 * (a - c) * shift

    (t, x), (t_exact, x_exact) = peaks(found), peaks(exact)
    n = int((x_exact > 0.05 * x_exact[0]).sum())
    n = min(n, len(x), len(x_exact))  # one at the very end may be in one of the two alone
    assert n >= 3
    assert np.diff(t[:n]) == pytest.approx(np.diff(t_exact[:n]), rel=0.01)
    decrement, wanted = (np.log(v[: n - 1] / v[1:n]) for v in (x, x_exact))
    assert decrement == pytest.approx(wanted, rel=0.03)


def response(model, database, omega, beta):
    """Complex motions [n, 6] per amplitude of the linear hull in waves [n], by the tables of a database."""
    C = np.zeros((6, 6))
    C[2:5, 2:5] = model.geometry.hydrostatics.stiffness(model.geometry.hydrostatics.equilibrium)
    at = np.abs(np.rad2deg(beta)[:, None] - database.heading_deg).argmin(axis=1)

    def by_omega(table):
        flat = table.reshape(len(database.omega), -1)
        columns = [np.interp(omega, database.omega, column) for column in flat.T]
        return np.stack(columns, 1).reshape(-1, *table.shape[1:])

    A, B, X = by_omega(database.added_mass), by_omega(database.damping), by_omega(database.excitation)
    w = omega[:, None, None]
    Z = -(w**2) * (model.params.M_rb + A) - 1j * w * B + C
    return np.linalg.solve(Z, X[np.arange(len(at)), at][..., None])[..., 0]


@pytest.mark.slow
def test_a_barge_answers_waves_as_its_database_says(barge, bench, database):
    """Amplitudes of heave, roll and pitch over their peaks, from 0.3 to 1.6 of each resonance, at every heading."""
    omega, heading = np.meshgrid(np.linspace(0.65, 4.8, 16), np.deg2rad([0, 30, 60, 90, 135, 180]), indexing="ij")
    w, beta = omega.ravel(), heading.ravel()
    wanted = np.abs(response(barge, database, w, beta))
    fine = [a.ravel() for a in np.meshgrid(np.linspace(0.65, 4.8, 800), np.unique(beta), indexing="ij")]
    everywhere = np.abs(response(barge, database, *fine))
    k = w**2 / GRAVITY
    amplitude = 1e-4 / k
    sea = Sea(Components(*(v[:, None] for v in (amplitude, k, w, beta, 0 * w))))
    team = bench(barge, sea, envs=len(w))
    team.put(settle=True)
    team.step([0.0, 0.0], round(600 / DT))
    time, rows = [], []
    for _ in range(round(40 / DT / 4)):
        team.step([0.0, 0.0], 4)
        motion = team.read()
        time.append(float(team.time[0]))
        rows.append(np.hstack([motion.position, motion.euler]))
    t, rows = np.array(time), np.array(rows)
    for mode in (2, 3, 4):
        peak, at = everywhere[:, mode].max(), fine[0][everywhere[:, mode].argmax()]
        for n in np.flatnonzero((w > 0.3 * at) & (w < 1.6 * at)):
            basis = np.stack([np.cos(w[n] * t), np.sin(w[n] * t), np.ones_like(t), t - t.mean()], 1)
            found = np.hypot(*np.linalg.lstsq(basis, rows[:, n, mode], rcond=None)[0][:2]) / amplitude[n]
            assert abs(found - wanted[n, mode]) < 0.05 * peak, (mode, w[n], beta[n])


# -- what is refused --------------------------------------------------------------------------------------------


def test_a_memory_that_would_make_energy_is_refused(tmp_path):
    with pytest.raises(ValueError, match="would make energy"):
        Memory([1.0, 2.0], [[0.5, 2.0], [2.0, 0.5]], np.ones((2, 6)))
    text = BARGE.read_text().replace('"memory_damping": [[', '"memory_damping": [[-')
    (tmp_path / "bad.hydro.json").write_text(text)
    with pytest.raises(ConfigError, match=r"bad.hydro.json: memory_damping: .* would make energy"):
        HydroDatabase.read(tmp_path / "bad.hydro.json")


def test_a_database_of_another_hull_or_of_other_water_is_refused(make_model, bench, barge):
    with pytest.raises(ConfigError, match="'barge.hydro.json' is of another hull"):
        make_model("barge", hydrodynamics=POTENTIAL, thrusters=None, hull={"draft": 0.4})
    with pytest.raises(ConfigError, match="needs a database"):
        make_model("barge", hydrodynamics={"radiation": "memory", "database": None})
    with pytest.raises(ConfigError, match=r"gone.hydro.json.; a copy of a vehicle needs"):
        make_model("barge", hydrodynamics=POTENTIAL | {"database": "gone.hydro.json"}, thrusters=None)
    shallow = Sea(Components(*(np.full((1, 1), v) for v in (0.0, 1.0, 1.0, 0.0, 0.0))), 1.2)
    with pytest.raises(ConfigError, match="the water is 1.2 m deep, the hydrodynamic database of the hull is of deep"):
        bench(barge, shallow, envs=1).step([0.0, 0.0])
