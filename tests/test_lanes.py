"""Whole vectors in kernels (kernels/lanes.py): fused products and sums, totals; with and without lanes.ll."""

# pyright: reportInvalidTypeForm=false, reportIndexIssue=false

import re
from pathlib import Path

import numpy as np
import pytest
import taichi as ti
import torch

from taichi_sim.kernels import lanes, runtime
from taichi_sim.kernels.lanes import WIDTH, laned1, laned_totals, totals, variables
from taichi_sim.kernels.runtime import Launcher, array1

FORMS = 9
Rows = ti.types.argpack(rows=laned1)


@pytest.fixture(params=[True, False], ids=["linked", "plain"])
def linked(request, monkeypatch):
    """Whether kernels call the functions of lanes.ll."""
    if not request.param:
        monkeypatch.setattr(lanes.platform, "machine", lambda: "another")
    with lanes.vectors():
        if lanes.linked() != request.param:
            pytest.skip("lanes.ll is for Linux on x86-64")
    return request.param


def test_a_product_and_a_sum(linked):
    """In every form; with lanes.ll they are rounded once, if the processor can."""

    @ti.kernel
    def run(x: laned1, s: float, out: laned1):
        for n in range(1):
            a, b, c = x[0], x[1], x[2]
            found = [
                a * b + c, c + a * b, a * b - c, c - a * b, s * a + c, c - a * s, a * b + 2, 1 - 2 * a, a * b + c * a
            ]  # fmt: skip
            for k in ti.static(range(FORMS)):
                out[n + k] = found[k]
            total = c
            total += a * b
            total -= b * c
            out[FORMS] = total

    x = torch.randn((3, WIDTH), generator=torch.Generator().manual_seed(1))
    small = 2.0**-12
    x[:, 0] = torch.tensor([1 + small, 1 + small, -1 - 2 * small])
    out = torch.zeros((FORMS + 1, WIDTH))
    with lanes.vectors():
        run(x, 0.3, out)
    a, b, c = x.double().numpy()
    s, ab = float(np.float32(0.3)), a * b
    exact = [ab + c, c + ab, ab - c, c - ab, s * a + c, c - a * s, ab + 2, 1 - 2 * a, ab + c * a, c + ab - b * c]
    assert np.abs(out.numpy() - np.array(exact)).max() < 2e-6
    flags = Path("/proc/cpuinfo")
    if not flags.exists() or " fma" in flags.read_text():
        assert out[0, 0] == out[1, 0] == (small**2 if linked else 0.0)


@pytest.mark.parametrize("count", [1, 5, 12, 18])
def test_totals(linked, count):
    """Of any number of vectors."""

    @ti.kernel
    def run(x: laned1, out: array1, rows: laned1):
        for _ in range(1):
            several = ti.static(variables(count, x[0] * 0.0))
            for k in ti.static(range(count)):
                several[k] += x[k]
            found = totals(several)
            for k in ti.static(range(count)):
                out[k] = found[k]
            row = ti.static(laned_totals(several))
            for k in ti.static(range(len(row))):
                rows[k] = row[k]

    x = torch.randn((count, WIDTH), generator=torch.Generator().manual_seed(count))
    out, rows = torch.zeros(count), torch.zeros((-(-count // WIDTH), WIDTH))
    with lanes.vectors():
        run(x, out, rows)
    assert torch.allclose(out, x.sum(dim=1), atol=1e-5)
    assert torch.equal(rows.flatten()[:count], out)


def test_the_bitcode_has_the_functions_of_its_source():
    """Each by its name."""
    names = re.findall(r"@(lanes_\w+)", lanes.BITCODE.with_suffix(".ll").read_text())
    assert len(names) == 6 and all(name.encode() in lanes.BITCODE.read_bytes() for name in names)


def test_vectors_begin_at_multiples_of_their_size():
    @ti.kernel
    def double(given: Rows):
        for n in given.rows:
            given.rows[n] = 2 * given.rows[n]

    numbers = torch.ones(3 * WIDTH + 1)
    with lanes.vectors():
        launcher = Launcher(double)
        launcher(runtime.pack(Rows, rows=numbers[:-1].view(3, WIDTH)))
        with pytest.raises(ValueError, match="a multiple of the vector's size"):
            launcher(runtime.pack(Rows, rows=numbers[1:].view(3, WIDTH)))
    assert numbers.tolist() == [2.0] * (3 * WIDTH) + [1.0]
