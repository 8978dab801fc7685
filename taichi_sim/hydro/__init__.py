"""Hydrodynamic databases of hulls by boundary elements (capytaine); tools/hydrodynamics.py is the command."""
