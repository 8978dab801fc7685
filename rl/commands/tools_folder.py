"""Where `tools` and `docs` lie: beside rl in a checkout, inside it in an installation."""

from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1]


def bundle() -> Path:
    """Folder that holds `tools` and `docs`."""
    inside = PACKAGE / "_bundle"
    return inside if inside.is_dir() else PACKAGE.parent
