"""taichi-sim: a sea and an atmosphere, and vehicles that feel them, for thousands of environments at once."""

import os as _os

import gymnasium as _gymnasium

# Taichi prints a banner on import; a library does not.
_os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "0")

__version__ = "0.1.0"

# Names only: Gymnasium imports the adapters when an environment is made.
for _name, _team in (("UsvFormation", "usv"), ("UavFormation", "uav")):
    _gymnasium.register(
        id=f"taichi_sim/{_name}-v0",
        entry_point="rl.gym:TeamEnv",
        vector_entry_point="rl.gym:TeamVectorEnv",
        kwargs={"team": _team},
    )
