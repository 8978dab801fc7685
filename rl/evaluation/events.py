"""What endings are called where people read of them: recordings and reports."""

EVENTS = {
    "collided": ("collision", "hit an obstacle or a team mate"),
    "lost": ("lost", "is too far from its slot"),
    "crashed": ("crashed", "has touched the water, with a wing tip or else"),
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
"""Field of Endings -> kind of event and what is said of it."""


def event_of(field: str) -> tuple[str, str]:
    """Kind of event and what is said of it; a field that is not in `EVENTS` speaks for itself."""
    return EVENTS.get(field, (field, f"has ended: {field.replace('_', ' ')}"))
