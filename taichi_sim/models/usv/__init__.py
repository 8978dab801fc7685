"""Surface vessels: one module per model and per load."""
