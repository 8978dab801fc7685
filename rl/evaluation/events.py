"""Readable texts for endings, in recordings and reports."""

EVENTS = {
    "collided": ("collision", "hit an obstacle or a team mate"),
    "lost": ("lost", "is too far from its slot"),
    "crashed": ("crashed", "has touched the water"),
    "stalled": ("stalled", "has not recovered from a stall"),
    "ditched": ("ditched", "has met the water, with its feet or a rotor"),
    "struck": ("struck", "has met a deck with a rotor"),
    "landed": ("landed", "has landed"),
    "hard": ("hard", "has come down too hard"),
    "toppled": ("toppled", "has toppled on the deck"),
    "slid": ("slid", "has slid on the deck"),
    "late": ("late", "has not landed in time"),
    "capsized": ("capsized", "has turned over"),
    "swamped": ("swamped", "has water on deck"),
    "grounded": ("grounded", "has touched the ground"),
    "left": ("left", "has left the area"),
    "diverged": ("diverged", "has no finite state any more"),
}
"""Name of an ending -> kind of event and its text, which follows the vehicle's name."""


def event_of(field: str) -> tuple[str, str]:
    """The kind and the text of an ending; an ending that is not in `EVENTS` gets a text made of its name."""
    return EVENTS.get(field, (field, f"has ended: {field.replace('_', ' ')}"))
