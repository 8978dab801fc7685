"""The one place that starts Taichi: architecture, precision, threads.

Taichi holds one program per process. `init` starts it; a second call with the same arguments does nothing,
with other arguments it starts afresh and every kernel is compiled again at its next launch.
"""

import contextlib
import io
import os
from dataclasses import dataclass
from typing import Literal

import taichi as ti
import torch

Precision = Literal["f32", "f64"]


@dataclass(frozen=True)
class Runtime:
    """What Taichi was started with."""

    arch: str
    precision: Precision
    threads: int

    @property
    def torch_dtype(self) -> torch.dtype:
        """The dtype of every state tensor."""
        return torch.float64 if self.precision == "f64" else torch.float32

    @property
    def device(self) -> torch.device:
        """Where state tensors live, so that kernels work on them in place."""
        return torch.device("cuda" if self.arch == "cuda" else "cpu")


_current: Runtime | None = None


def init(arch: str = "cpu", precision: Precision = "f32", threads: int = 0) -> Runtime:
    """Start Taichi, once.

    Args:
        arch: "cpu" or "cuda".
        precision: "f32" for simulation, "f64" for validation against reference tables.
        threads: CPU threads for kernels; 0 means one per available core.

    Raises:
        ValueError: for an unknown architecture or precision.
    """
    global _current
    if arch not in ("cpu", "cuda"):
        raise ValueError(f"arch = {arch!r}: allowed are 'cpu' and 'cuda'")
    if precision not in ("f32", "f64"):
        raise ValueError(f"precision = {precision!r}: allowed are 'f32' and 'f64'")
    wanted = Runtime(arch, precision, threads or len(os.sched_getaffinity(0)))
    if _current != wanted:
        with contextlib.redirect_stdout(io.StringIO()):  # its greeting; a command's stdout is its result
            ti.init(
                arch=getattr(ti, arch),
                default_fp=ti.f64 if precision == "f64" else ti.f32,
                cpu_max_num_threads=wanted.threads,
                fast_math=True,
                offline_cache=True,
                log_level=ti.ERROR,
                verbose=False,
            )
        _current = wanted
    return wanted


def current() -> Runtime:
    """The running Taichi program; starts the default one if there is none."""
    return _current or init()


def is_f64() -> bool:
    """Whether kernels compiled now work in double precision (read inside `ti.static`)."""
    return current().precision == "f64"
