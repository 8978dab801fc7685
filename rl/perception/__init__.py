"""Perception: what vehicles measure of themselves and of others, and what they transmit to each other."""
