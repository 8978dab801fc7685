"""An autopilot in the loop: our vehicles as the physics of ArduPilot's SITL, or of PX4's (docs/sitl.md)."""
