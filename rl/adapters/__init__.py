"""A mission as other libraries see it: Gymnasium, PettingZoo, Stable-Baselines3, skrl, plain torch."""
