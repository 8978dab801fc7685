"""`fixed_wing_6dof`: fixed-wing aircraft in wind; fixed_wing_6dof.py is where to begin."""
