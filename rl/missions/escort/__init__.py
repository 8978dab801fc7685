"""The escort mission: boats hold formation about a manoeuvring vessel, guided by aircraft that see it."""
