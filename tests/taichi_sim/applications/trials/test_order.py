"""Order of convergence: halving the physics step quarters the error of every model's motion.

Waves, wind, turbulence and random commands are the same at every step (taichi_sim/applications/trials/step_error.py).
The models of the paper are left out: their step is part of the model.
"""

import numpy as np
import pytest

from taichi_sim.applications.trials.step_error import StepSetting, errors

pytestmark = pytest.mark.usefixtures("f64")
LEAST = 1.8
STEPS, FINE = (0.01, 0.02, 0.04), 0.0025  # s
LONG_STEPS = {"fpso": (0.05, 0.1, 0.2)}  # s; at 0.01 s a ship of 200 m errs by 5e-6, and what its tables round shows
WEAK = {
    "capacity_mah": 300.0, "full": 15.2, "empty": 14.0, "nominal": 14.8, "resistance": 0.05, "efficiency": 0.75,
}  # fmt: skip
CHANGES = {"x500": {"battery": WEAK}}
SLOW = "aerosonde", "otter", "wamv", "barge", "fpso", "kvlcc2_6dof", "kvlcc2", "otter_3dof", "zagi", "x500", "t650"


@pytest.mark.parametrize("vehicle", ["cybership2", *(pytest.param(name, marks=pytest.mark.slow) for name in SLOW)])
def test_half_the_step_makes_a_quarter_of_the_error(vehicle):
    setting = StepSetting(vehicle, seconds=6.0, envs=4, changes=CHANGES.get(vehicle, {}))
    found = np.array([error.total for error in errors(setting, LONG_STEPS.get(vehicle, STEPS), FINE)])
    order = np.log2(found[1:] / found[:-1])
    assert order.min() > LEAST, (found, order)
