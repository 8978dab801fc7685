"""Catamarans in regular waves, run in time, against the response that their boundary-element databases make of them."""

import numpy as np
import pytest

from taichi_sim.models.catalogue import load_vehicle
from taichi_sim.models.usv.hull.radiation import cubic
from tests.validation.regular import motions
from tests.validation.remembering import NO_DAMPING, slowest_decay

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("f64")]

DT, SAMPLE = 0.007, 16  # s; steps from sample to sample
AT_REST = (5.0, 10.0, 0.0, 0.0, 0.0, 5.0)  # damping of surge, sway and yaw, by which they come to rest; waves: some 100
RINGING = 4.0  # s, time constant of the water between the hulls
MODES = {"heave": 2, "roll": 3, "pitch": 4}
BAND = 0.3, 1.6  # of the resonance


@pytest.mark.parametrize(("name", "of_peak"), [("otter", 0.07), ("wamv", 0.15)])
def test_a_catamaran_moves_in_waves_as_its_database_says(name, of_peak):
    """Heave, roll and pitch, each over 0.3 to 1.6 of its resonance and all headings; errors over the peak."""
    water = NO_DAMPING | {"linear": AT_REST}
    model = load_vehicle(name, DT, SAMPLE, hydrodynamics=water, thrusters=None)
    database = model.radiation.database
    resonance = np.array(database.settings["resonances"])
    omega = np.linspace(BAND[0] * resonance.min(), BAND[1] * resonance.max(), 40)
    heading = database.heading_deg
    rows = [x.ravel() for x in np.meshgrid(omega, np.deg2rad(heading), indexing="ij")]
    ours = np.abs(motions(model, *rows, max(RINGING, slowest_decay(model, database)))).reshape(
        len(omega), len(heading), 6
    )
    A, B = (cubic(database.omega, table, omega) for table in (database.added_mass, database.damping))
    X = cubic(database.omega, database.excitation.real, omega) + 1j * cubic(
        database.omega, database.excitation.imag, omega
    )
    w = omega[:, None, None]
    Z = -(w**2) * (model.params.M_rb + A) - 1j * w * (B + np.diag(AT_REST)) + database.stiffness
    theirs = np.abs(np.linalg.solve(Z[:, None], X[..., None])[..., 0])
    off = {}
    for n, (motion, mode) in enumerate(MODES.items()):
        use = (omega > BAND[0] * resonance[n]) & (omega < BAND[1] * resonance[n])
        off[motion] = np.abs(ours - theirs)[use, :, mode].max() / theirs[use, :, mode].max()
    assert max(off.values()) < of_peak, off
