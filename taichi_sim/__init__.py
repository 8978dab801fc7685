"""taichi-sim: a sea and an atmosphere, and vehicles that feel them, for thousands of environments at once."""

import os as _os

# Taichi prints a banner on import; a library does not.
_os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "0")

__version__ = "0.1.0"
