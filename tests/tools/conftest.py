"""Commands in this process."""

from command_line import here, place_of_the_tiny_run, run  # noqa: F401 fixtures
