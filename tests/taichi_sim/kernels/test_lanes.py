"""Whole vectors in kernels (kernels/lanes.py): their operators, and totals of their lanes."""

# pyright: reportInvalidTypeForm=false, reportIndexIssue=false

import numpy as np
import pytest
import taichi as ti
import torch

from taichi_sim.kernels import lanes, runtime
from taichi_sim.kernels.lanes import WIDTH, laned1, laned_totals, totals, variables
from taichi_sim.kernels.runtime import Launcher, array1

Rows = ti.types.argpack(rows=laned1)


def test_operators():
    """Of vectors among themselves, and with numbers; v += w and the like."""

    @ti.kernel
    def run(x: laned1, s: float, out: laned1):
        for n in range(1):
            a, b, c = x[0], x[1], x[2]
            found = [a * b + c, c - a * b, s * a - c, 1 - 2 * a, a / b, -a, ti.abs(a)]
            for k in ti.static(range(7)):
                out[n + k] = found[k]
            total = c
            total += a * b
            total -= b * c
            total *= a
            out[7] = total

    x = torch.randn((3, WIDTH), generator=torch.Generator().manual_seed(1))
    out = torch.zeros((8, WIDTH))
    with lanes.vectors():
        run(x, 0.3, out)
    a, b, c = x.double().numpy()
    s = float(np.float32(0.3))
    exact = [a * b + c, c - a * b, s * a - c, 1 - 2 * a, a / b, -a, np.abs(a), (c + a * b - b * c) * a]
    np.testing.assert_allclose(out.numpy(), exact, rtol=2e-6, atol=2e-6)


@pytest.mark.parametrize("count", [1, 5, 12, 18])
def test_totals(count):
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
