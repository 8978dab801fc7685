"""What shows an episode: recordings, films, plots."""
