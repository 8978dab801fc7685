"""`multirotor_6dof`: aircraft on any number of rotors; multirotor_6dof.py is where to begin."""
