"""Encounters under the rules of the road at sea (COLREGs)."""
