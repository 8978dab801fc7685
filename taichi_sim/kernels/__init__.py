"""Mathematics that kernels share: vectorisable functions, rotations."""
