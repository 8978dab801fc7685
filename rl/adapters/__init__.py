"""Missions behind the interfaces of other libraries: Gymnasium, PettingZoo, Stable-Baselines3, skrl, plain torch.

Importing this registers the Gymnasium ids. They are names alone: an environment's module is imported when it is made.
"""

import gymnasium

for _scenario, _team, _other in (
    ("paper", "usv", "absent"),
    ("paper", "uav", "absent"),
    ("lanes", "usv", "absent"),
    ("lanes", "uav", "absent"),
    ("cruise", "usv", "absent"),
    ("cruise", "uav", "absent"),
    ("otter", "usv", "absent"),
    ("aerosonde", "uav", "absent"),
    ("escort", "usv", "absent"),  # scripted scouts replace the aircraft
    ("escort", "uav", "classical"),  # its reward depends on what boats do with the messages
    ("landing", "uav", "absent"),  # a helm holds the boat's course
    ("station", "usv", "absent"),
    ("route", "usv", "absent"),
    ("encounter", "usv", "absent"),
    ("imazu", "usv", "absent"),
):
    _name = f"{_team}_formation" if _scenario == "paper" else f"{_scenario}_{_team}"
    gymnasium.register(
        id=f"taichi_sim/{_name.title().replace('_', '')}-v0",
        entry_point="rl.adapters.gymnasium:TeamEnv",
        vector_entry_point="rl.adapters.gymnasium:TeamVectorEnv",
        kwargs={"team": _team, "scenario": _scenario, "other": _other},
    )
