"""From a hull to its hydrodynamic database."""
