"""`fixed_wing_6dof`: fixed-wing aircraft in wind. Start reading at fixed_wing_6dof.py."""
