"""Contact between vehicles: legs that stand on decks of other vehicles (docs/contact.md)."""
