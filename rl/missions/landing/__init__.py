"""The landing mission: multirotors land on the decks of boats in a seaway (mission.py)."""
