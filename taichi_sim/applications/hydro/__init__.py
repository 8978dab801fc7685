"""Hydrodynamic databases of hulls by boundary elements (capytaine). The command is tools/hydrodynamics.py."""
