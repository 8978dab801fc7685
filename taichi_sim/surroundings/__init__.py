"""What a world has around its vehicles: sea, current, wind."""
