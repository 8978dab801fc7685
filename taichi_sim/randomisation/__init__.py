"""Differences between environments: sea, wind and current of each realisation, numbers of each vehicle."""
