"""The escort mission: vessels hold formation about one that manoeuvres as it likes, guided by aircraft that see it."""
