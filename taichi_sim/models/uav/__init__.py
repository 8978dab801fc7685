"""Aircraft: one module per model."""
