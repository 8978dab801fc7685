"""Packages that not everybody needs: extras of pyproject.toml."""


class MissingExtraError(ImportError):
    """A package that is not installed, and how to install it."""

    def __init__(self, package: str, extra: str):
        """Of `package`, which the extra brings."""
        super().__init__(f'{package} is not installed: pip install "taichi-sim[{extra}]"', name=package)
