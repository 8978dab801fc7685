"""The error for a missing optional package (extras of pyproject.toml)."""


class MissingExtraError(ImportError):
    """An optional package is not installed; the message says how to install it."""

    def __init__(self, package: str, extra: str):
        """Name the missing `package` and the extra that installs it."""
        super().__init__(f'{package} is not installed: pip install "taichi-sim[{extra}]"', name=package)
