"""Station keeping and docking of one boat."""
