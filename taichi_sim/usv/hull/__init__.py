"""`hull_6dof`: hulls in six degrees of freedom; hull_6dof.py is where to begin."""
