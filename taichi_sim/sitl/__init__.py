"""ArduPilot in the loop: our vehicles as the physics of its SITL, by its JSON interface (docs/sitl.md)."""
