"""Folders that tests read, wherever a test lies."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
TESTS = ROOT / "tests"
REFERENCE = TESTS / "data" / "reference"
PLUGINS = TESTS / "data" / "plugins"
