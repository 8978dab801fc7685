"""The odds of rare failures: multilevel splitting on kept states."""
