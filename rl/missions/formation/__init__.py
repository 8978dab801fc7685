"""The formation task in plain torch: tracks, slots, observations, rewards, endings, starts."""
