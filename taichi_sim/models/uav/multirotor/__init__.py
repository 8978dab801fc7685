"""`multirotor_6dof`: aircraft on any number of rotors. Start reading at multirotor_6dof.py."""
