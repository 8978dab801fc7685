import math

import numpy as np
import pytest
import taichi as ti
import torch

from taichi_sim.kernels import random, runtime

pytestmark = pytest.mark.usefixtures("precision")
INDICES = ("seed", "stream", "env", "vehicle", "step")

# rounds, counter, key, words: kat_vectors of the Random123 library (Salmon et al. 2011)
KNOWN = (
    (7, "00000000 00000000 00000000 00000000", "00000000 00000000", "5f6fb709 0d893f64 4f121f81 4f730a48"),
    (7, "ffffffff ffffffff ffffffff ffffffff", "ffffffff ffffffff", "5207ddc2 45165e59 4d8ee751 8c52f662"),
    (7, "243f6a88 85a308d3 13198a2e 03707344", "a4093822 299f31d0", "4dfccaba 190a87f0 c47362ba b6b5242a"),
    (10, "00000000 00000000 00000000 00000000", "00000000 00000000", "6627e8d5 e169c58d bc57ac4c 9b00dbd8"),
    (10, "ffffffff ffffffff ffffffff ffffffff", "ffffffff ffffffff", "408f276d 41c83b0e a20bc7c6 6d5451fd"),
    (10, "243f6a88 85a308d3 13198a2e 03707344", "a4093822 299f31d0", "d16cfe09 94fdcceb 5001e420 24126ea1"),
)


@ti.kernel
def _philox(inputs: ti.types.ndarray(dtype=ti.u32, ndim=1), out: ti.types.ndarray(dtype=ti.u32, ndim=2)):
    for i in range(1):
        counter = ti.Vector([inputs[0], inputs[1], inputs[2], inputs[3]])
        key = ti.Vector([inputs[4], inputs[5]])
        seven, ten = random.philox(counter, key, 7), random.philox(counter, key, 10)
        for k in ti.static(range(4)):
            out[i, k], out[i + 1, k] = seven[k], ten[k]


@ti.kernel
def _draw(
    index: ti.types.ndarray(dtype=ti.i32, ndim=2),
    uniform: ti.types.ndarray(ndim=2),
    normal: ti.types.ndarray(ndim=2),
):
    for i in range(index.shape[0]):
        u = random.uniform4(index[i, 0], index[i, 1], index[i, 2], index[i, 3], index[i, 4])
        z = random.normal6(index[i, 0], index[i, 1], index[i, 2], index[i, 3], index[i, 4])
        for k in ti.static(range(4)):
            uniform[i, k] = u[k]
        for k in ti.static(range(6)):
            normal[i, k] = z[k]


@ti.kernel
def _log(x: ti.types.ndarray(ndim=1), out: ti.types.ndarray(ndim=1)):
    for i in x:
        out[i] = random.log(x[i])


def _draws(index):
    """Uniform [n, 4] and normal [n, 6] numbers of indices [n, 5], as the run's precision has them."""
    dtype = runtime.current().torch_dtype
    index = torch.as_tensor(index, dtype=torch.int32).contiguous()
    uniform, normal = torch.zeros(len(index), 4, dtype=dtype), torch.zeros(len(index), 6, dtype=dtype)
    _draw(index, uniform, normal)
    return uniform, normal


def _along(name, n):
    """Indices [n, 5] that count along one of the five."""
    index = torch.tensor([7, 1, 0, 0, 0], dtype=torch.int32).repeat(n, 1)
    index[:, INDICES.index(name)] = torch.arange(n, dtype=torch.int32)
    return index


@pytest.fixture(scope="module")
def sample(precision):
    """Uniform and normal numbers, float64, of 400 000 environments."""
    return [draws.double() for draws in _draws(_along("env", 400_000))]


@pytest.mark.parametrize(("rounds", "counter", "key", "words"), KNOWN)
def test_philox_known_answers(rounds, counter, key, words):
    inputs = np.array([int(word, 16) for word in f"{counter} {key}".split()], dtype=np.uint32)
    out = np.zeros((2, 4), dtype=np.uint32)
    _philox(inputs, out)
    assert [f"{word:08x}" for word in out[(7, 10).index(rounds)]] == words.split()


def test_logarithm(precision):
    x = torch.linspace(-80, 80, 100_001, dtype=torch.float64).exp()
    x = torch.cat((x, torch.linspace(0.5, 2.0, 100_001, dtype=torch.float64))).to(runtime.current().torch_dtype)
    out = torch.zeros_like(x)
    _log(x, out)
    exact = x.double().log()
    error = (out.double() - exact).abs() / exact.abs().clamp(min=1.0)
    assert error.max() < {"f64": 1e-15, "f32": 2e-7}[precision]


def test_any_number_of_threads_gives_the_same_bits(precision):
    index = _along("step", 5000)
    one = _draws(index)
    runtime.init(precision=precision, threads=2)
    two = _draws(index)
    runtime.init(precision=precision, threads=1)
    assert all(torch.equal(a, b) for a, b in zip(one, two, strict=True))


def test_every_index_makes_other_numbers():
    """All 7^5 neighbours of one another differ: 92 bits cannot agree by chance."""
    count = torch.arange(7, dtype=torch.int32)
    uniform, _ = _draws(torch.cartesian_prod(*[count] * 5))
    assert len(torch.unique(uniform, dim=0)) == 7**5


def test_uniform_numbers_are_uniform(sample):
    """Chi-square of 1000 bins, each word; its mean is 999 and its variance 2 * 999."""
    uniform = sample[0]
    assert uniform.min() > 0 and uniform.max() < 1
    for word in uniform.T:
        counts = torch.histc(word, 1000, 0.0, 1.0)
        expected = len(word) / 1000
        chi2 = float(((counts - expected) ** 2).sum() / expected)
        assert abs(chi2 - 999) < 4.5 * math.sqrt(2 * 999)


def test_pairs_of_words_fill_the_square(sample):
    """Chi-square of 32 x 32 cells for each pair of words of one call."""
    cells = (sample[0] * 32).long()
    for a in range(4):
        for b in range(a):
            counts = torch.bincount(cells[:, a] * 32 + cells[:, b], minlength=1024).double()
            expected = len(cells) / 1024
            chi2 = float(((counts - expected) ** 2).sum() / expected)
            assert abs(chi2 - 1023) < 4.5 * math.sqrt(2 * 1023)


def test_moments_of_normal_numbers(sample):
    """Means of z, z^2, z^3, z^4 are 0, 1, 0, 3, with variances 1, 2, 15, 96 over n."""
    normal = sample[1]
    for power, mean, variance in ((1, 0, 1), (2, 1, 2), (3, 0, 15), (4, 3, 96)):
        error = (normal**power).mean(dim=0) - mean
        assert error.abs().max() < 4.5 * math.sqrt(variance / len(normal))


def test_normal_numbers_have_the_normal_distribution(sample):
    """Kolmogorov-Smirnov: sqrt(n) D exceeds 2.2 once in 8000 times (2 exp(-2 x^2))."""
    z = sample[1].flatten().sort().values
    rank = (torch.arange(len(z), dtype=torch.float64) + 0.5) / len(z)
    assert math.sqrt(len(z)) * (torch.special.ndtr(z) - rank).abs().max() < 2.2


def test_tails(sample):
    """Beyond 3, 4 and 4.5 as many as there should be; none beyond the largest radius."""
    z = sample[1].abs().flatten()
    for bound in (3.0, 4.0, 4.5):
        expected = z.numel() * math.erfc(bound / math.sqrt(2))
        assert abs(int((z > bound).sum()) - expected) < 4.5 * math.sqrt(expected)
    assert z.max() < math.sqrt(2 * 24 * math.log(2)) + 1e-6


def test_components_are_independent(sample):
    """Correlations of z and of z^2 between the six numbers of a call."""
    for values in (sample[1], sample[1] ** 2):
        correlation = torch.corrcoef(values.T) - torch.eye(6)
        assert correlation.abs().max() < 4.5 / math.sqrt(len(values))


@pytest.mark.parametrize("name", INDICES)
def test_neighbours_are_independent(name):
    """Correlations of z and of z^2 between index i and i + 1, all 36 pairs of numbers."""
    z = _draws(_along(name, 200_001))[1].double()
    for values in (z, z**2):
        standard = (values - values.mean(dim=0)) / values.std(dim=0)
        correlation = standard[1:].T @ standard[:-1] / (len(z) - 1)
        assert correlation.abs().max() < 4.5 / math.sqrt(len(z) - 1)


def test_both_precisions_draw_the_same():
    """What f32 rounds away is all that differs (uniform numbers are exact in both)."""
    index, precision = _along("step", 2000), runtime.current().precision
    draws = {}
    for each in ("f64", "f32"):
        runtime.init(precision=each, threads=1)
        draws[each] = [d.double() for d in _draws(index)]
    runtime.init(precision=precision, threads=1)
    assert torch.equal(draws["f64"][0], draws["f32"][0])
    assert (draws["f64"][1] - draws["f32"][1]).abs().max() < 1e-5
