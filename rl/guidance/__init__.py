"""Guidance to targets, for any mission: errors from slots, avoidance, classical controllers, residual policies."""
