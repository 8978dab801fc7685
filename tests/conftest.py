"""Fixtures shared by all tests, and their order: what Taichi has compiled serves as many tests as possible.

Taichi compiles a kernel anew after every change of precision or threads, and in every worker. So a worker takes all
tests of one precision from tests/rl, or from files whose names begin alike (--dist loadgroup). The first worker begins
with tests/rl, which takes longest, the others with those in double precision. Missions whose kernels few other tests of
tests/rl need go by themselves (APART), and a page whose vehicles are theirs goes with tests/rl (WITHIN).
"""

import os
from pathlib import Path

import pytest
import torch
from refusal import MINIMAL

from taichi_sim.kernels import runtime
from taichi_sim.models import catalogue

# Taichi's own passes take two thirds of the time to compile a kernel, for some hundredths of its speed: LLVM's follow
# all the same. Taichi reads this, in what tests start too.
os.environ["TI_OPT_LEVEL"] = "0"


FOLDER = Path(__file__).parent
APART = {"landing", "encounter", "station"}  # below tests/rl, by a word of a file's name
WITHIN = "extending"


def _precision_of(item: pytest.Item) -> runtime.Precision:
    """What a test runs in: the parameter of `precision`, double with `f64`, or else single."""
    of_parameters = getattr(item, "callspec", None)
    if of_parameters and "precision" in of_parameters.params:
        return of_parameters.params["precision"]
    return "f64" if "f64" in item.fixturenames else "f32"


def _group_of(item: pytest.Item) -> str:
    """The tests that a worker takes together."""
    subject, *others = item.path.stem.split("_")[1:]
    if FOLDER / "rl" in item.path.parents or subject == WITHIN:
        subject = next(iter(APART & {subject, *others}), "rl")
    return f"{subject}-{_precision_of(item)}"


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    items.sort(key=lambda item: (_group_of(item) != "rl-f32", _precision_of(item) == "f32"))
    for item in items:
        item.add_marker(pytest.mark.xdist_group(_group_of(item)))


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item):
    runtime.init(precision=_precision_of(item), threads=1)
    torch.set_num_threads(1)  # as many workers run at once


@pytest.fixture(scope="module")
def f64():
    """Taichi in double precision."""


@pytest.fixture
def anything_goes(monkeypatch):
    """Vehicle files with numbers that no vehicle has, as closed forms need them."""
    monkeypatch.setattr(catalogue, "judge", lambda *_: None)


@pytest.fixture(scope="module", params=["f64", "f32"])
def precision(request):
    """Taichi in double, then in single precision: each test runs in both."""
    return request.param


@pytest.fixture
def scenario(tmp_path: Path):
    """Write a scenario: `top` before the sections of a minimal one, `end` after them."""

    def write(top: str = "", end: str = "") -> Path:
        file = tmp_path / "little.toml"
        file.write_text(top + MINIMAL + end, encoding="utf-8")
        return file

    return write
