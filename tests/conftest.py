"""Fixtures shared by all tests."""

import pytest

from taichi_sim import runtime


def _run_in(precision):
    runtime.init(precision=precision, threads=1)
    yield precision
    runtime.init()


@pytest.fixture(scope="module")
def f64():
    """Taichi in double precision while a module's tests run."""
    yield from _run_in("f64")


@pytest.fixture(scope="module", params=["f64", "f32"])
def precision(request):
    """Taichi in double, then in single precision: each test of a module runs in both."""
    yield from _run_in(request.param)
