"""Decks and legs: vehicles that stand on other vehicles (docs/contact.md); contacts.py says how and when."""
