"""taichi-sim: a sea and an atmosphere, and vehicles that feel them, for thousands of environments at once."""

import os as _os

import gymnasium as _gymnasium

# Taichi prints a banner on import; a library does not.
_os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "0")
# OpenMP threads of torch spin while they wait for each other. On a machine that does anything else at the same time
# that made PPO 10 to 20 times slower; sleeping after a short spin costs nothing when it is idle. Counts before torch
# is imported.
_os.environ.setdefault("GOMP_SPINCOUNT", "30000")

__version__ = "0.1.0"

# Names only: Gymnasium imports the adapters when an environment is made.
for _name, _team in (("UsvFormation", "usv"), ("UavFormation", "uav")):
    _gymnasium.register(
        id=f"taichi_sim/{_name}-v0",
        entry_point="rl.gym:TeamEnv",
        vector_entry_point="rl.gym:TeamVectorEnv",
        kwargs={"team": _team},
    )
