"""Planning in forks of a mission: what could be done, for tables of results, for teaching, and as a controller."""
