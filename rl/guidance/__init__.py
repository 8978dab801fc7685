"""Steering about targets, for any mission: errors from slots, avoidance, classical controllers, corrections of them."""
