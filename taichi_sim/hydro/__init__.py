"""From a hull to its hydrodynamic database by a boundary-element code; tools/hydrodynamics.py is where to begin."""
