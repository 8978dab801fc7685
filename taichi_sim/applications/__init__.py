"""What is done with vehicles: trials, fits to logs, autopilots in the loop, databases of hulls."""
