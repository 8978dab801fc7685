"""`hull_6dof`: hulls in six degrees of freedom. Start reading at hull_6dof.py."""
