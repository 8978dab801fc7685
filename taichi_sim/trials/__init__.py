"""Trials: what is measured of a vehicle alone, by the field's definitions: of ships, aircraft and multirotors."""
