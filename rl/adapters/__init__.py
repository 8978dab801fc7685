"""Missions behind the interfaces of other libraries: Gymnasium, PettingZoo, Stable-Baselines3, skrl, plain torch."""
