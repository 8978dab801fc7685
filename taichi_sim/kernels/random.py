"""Stateless random numbers for kernels: a function of (seed, stream, env, vehicle, step) and nothing else.

A run therefore has the same bits on any number of threads, and no environment disturbs another. The bits are those of
Philox4x32 with 7 rounds (Salmon, Moraes, Dror & Shaw 2011, Parallel random numbers: as easy as 1, 2, 3). 7 rounds are
the fewest that pass BigCrush there. counter = (step, vehicle, env, 0), key = (seed, stream).

`step` must keep counting through a run. A counter that restarts with each episode would repeat the noise of the last
one.

Normal numbers are by Box & Muller (1958). The 128 bits of one call make six of them, from three radii of 24 bits and
three angles of 18 bits: |z| <= sqrt(2 ln 2^24) = 5.77.

`Noise` counts for a source of noise: `step` is its clock, and `env` a key of each environment. Two environments with
the same key draw the same numbers; environments with different keys draw independent ones.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

import math

import numpy as np
import taichi as ti
import torch
from torch import Tensor

from taichi_sim.kernels import fast_maths, runtime
from taichi_sim.kernels.abreast import bit_cast, cast
from taichi_sim.kernels.lanes import is_laned
from taichi_sim.kernels.runtime import array1, array2, whole1
from taichi_sim.state.memory import Remembers

# Streams: one for each use of random numbers, so that no two uses share them.
TURBULENCE, SLOW_VARIATION = 1, 2
INSTRUMENTS, RADIO, CONTACTS = 16, 32, 48  # each use also has the next 15 streams, CONTACTS the next 31
CAMERA, LOOKOUT = 80, 96  # each use also has the next 15 streams
TRAFFIC, AIS, RADAR = 112, 128, 160  # each use also has the next 31 streams, TRAFFIC the next 15

CLOCK, SEED, KEY = range(3)  # where a counter (`Noise.table`) holds them; the key of the first environment

ROUNDS = 7
MULTIPLIER_0, MULTIPLIER_1 = 0xD2511F53, 0xCD9E8D57  # constants of Philox
WEYL_0, WEYL_1 = 0x9E3779B9, 0xBB67AE85  # increments of the key in each round

UNIFORM_BITS, RADIUS_BITS, ANGLE_BITS = 23, 24, 18
ANGLE_BITS_OF_LAST = 10  # bits of an angle from the fourth word; its other bits are left over from the radius

SQRT_HALF_BITS = 0x3F3504F3  # sqrt(1/2) as an f32
LN2_HI, LN2_LO = 0.693359375, -2.12194440e-4  # ln 2 split in two, so that n LN2_HI is exact in f32
TWO_PI = 6.283185307179586
DIGITS, EXPONENT_23 = (1 << 23) - 1, 0x4B000000  # mask of the digits of an f32; 2^23 as an f32
KEPT, ADDED = range(2)  # numbers of a slow variation's step: share that is kept, deviation of the noise
FIRST_FORKED = 1 << 24  # first key of copies that draw noise of their own; above the number of any environment


@ti.func
def float_below(m, bits: ti.template()):
    """m, a u32 below 2^bits, as a float; bits <= 24.

    A group's numbers (abreast.py) become the last digits of a float of known exponent, because LLVM would convert them
    one by one.
    """
    if ti.static(not is_laned(m)):
        return ti.cast(m, float)
    else:
        digits = bit_cast((m & ti.u32(DIGITS)) | ti.u32(EXPONENT_23), ti.f32)
        low = fast_maths.at_least(digits - ti.static(2.0**23), 0.0)  # the bound keeps fast math from multiplying out
        if ti.static(bits == 24):
            return ti.select(m > ti.u32(DIGITS), low + ti.static(2.0**23), low)
        else:
            return low


@ti.func
def log(x):
    """Return ln x of x > 0 (a normal f32) with an error of 2e-7 max(1, |ln x|).

    Range reduction is x = 2^n (1 + f), f in [-0.293, 0.414]. The polynomial in f is that of logf in Moshier's Cephes
    library. In f64 this is the library's function.
    """
    y = x
    if ti.static(runtime.is_f64()):
        y = ti.log(x)
    else:
        bits = bit_cast(x, ti.i32)
        n = (bits - ti.static(SQRT_HALF_BITS)) >> 23
        f = bit_cast(bits - (n << 23), ti.f32) - 1.0
        z, p = f * f, x * 0.0 + 7.0376836292e-2
        for c in ti.static(
            (-1.1514610310e-1, 1.1676998740e-1, -1.2420140846e-1, 1.4249322787e-1)
            + (-1.6668057665e-1, 2.0000714765e-1, -2.4999993993e-1, 3.3333331174e-1)
        ):
            p = p * f + c
        k = fast_maths.float_of(n)
        y = f + (z * f * p + k * LN2_LO - 0.5 * z) + k * LN2_HI
    return y


@ti.func
def philox(counter, key, rounds: ti.template()):
    """Philox4x32: four random words from a counter (4 u32) and a key (2 u32)."""
    c0, c1, c2, c3 = counter[0], counter[1], counter[2], counter[3]
    k0, k1 = key[0], key[1]
    for _ in ti.static(range(rounds)):
        product0 = ti.cast(c0, ti.u64) * ti.cast(ti.u32(MULTIPLIER_0), ti.u64)
        product1 = ti.cast(c2, ti.u64) * ti.cast(ti.u32(MULTIPLIER_1), ti.u64)
        c0 = ti.cast(product1 >> 32, ti.u32) ^ c1 ^ k0
        c2 = ti.cast(product0 >> 32, ti.u32) ^ c3 ^ k1
        c1, c3 = ti.cast(product1, ti.u32), ti.cast(product0, ti.u32)
        k0, k1 = k0 + ti.u32(WEYL_0), k1 + ti.u32(WEYL_1)
    return ti.Vector([c0, c1, c2, c3])


@ti.func
def words4(seed, stream, env, vehicle, step):
    """Four random u32 from integers, each of them taken modulo 2^32."""
    counter = ti.Vector([ti.cast(step, ti.u32), ti.cast(vehicle, ti.u32), ti.cast(env, ti.u32), ti.u32(0)])
    return philox(counter, ti.Vector([ti.cast(seed, ti.u32), ti.cast(stream, ti.u32)]), ROUNDS)


@ti.func
def uniform4(seed, stream, env, vehicle, step):
    """Four uniform numbers strictly between 0 and 1, in steps of 2^-23, the same in f32 and f64."""
    w = words4(seed, stream, env, vehicle, step)
    u = ti.Vector([0.0, 0.0, 0.0, 0.0])
    for i in ti.static(range(4)):
        u[i] = (ti.cast(w[i] >> (32 - UNIFORM_BITS), float) + 0.5) * ti.static(2.0**-UNIFORM_BITS)
    return u


@ti.func
def normal6(seed, stream, env, vehicle, step):
    """Six independent standard normal numbers; env and vehicle may be those of a group (abreast.py)."""
    w = words4(seed, stream, env, vehicle, step)
    zero = 0.0 * cast(env, float)
    z = ti.Vector([zero, zero, zero, zero, zero, zero])
    for i in ti.static(range(3)):
        u = (float_below(w[i] >> (32 - RADIUS_BITS), RADIUS_BITS) + 1.0) * ti.static(2.0**-RADIUS_BITS)
        high = (w[i] & ti.u32(2 ** (32 - RADIUS_BITS) - 1)) << ti.static(ANGLE_BITS_OF_LAST)
        low = (w[3] >> (ANGLE_BITS_OF_LAST * i)) & ti.u32(2**ANGLE_BITS_OF_LAST - 1)
        angle = float_below(high | low, ANGLE_BITS)
        theta = (angle + 0.5) * ti.static(TWO_PI * 2.0**-ANGLE_BITS) - ti.static(0.5 * TWO_PI)
        r = ti.sqrt(ti.max(-2.0 * log(u), 0.0))
        s, c = theta, theta
        if ti.static(runtime.is_f64()):
            s, c = ti.sin(theta), ti.cos(theta)
        else:
            s, c = fast_maths.sin_reduced(theta), fast_maths.cos_reduced(theta)
        z[2 * i], z[2 * i + 1] = r * c, r * s
    return z


class Noise(Remembers):
    """Counter of one source of noise.

    Attributes:
        table: int32 [2 + env], the kernels' argument `count`: clock, seed, and the key of each environment, modulo
        2^32.
        keys: int32 [env], a live view; the key of an environment is its number unless it is a copy of another one.
        clock: number of steps so far.
        seed: seed of the random numbers.
    """

    def __init__(self, num_envs: int, seed: int = 0, clock: int = 0):
        """Begin a counter for `num_envs` environments."""
        self.table = torch.zeros(2 + num_envs, dtype=torch.int32, device=runtime.current().device)
        self._head, self.keys = self.share(self.table[:2]), self.remember(self.table[2:])
        self.seed, self.clock = self.share(seed), self.share(clock)
        self.keys.copy_(torch.arange(num_envs))
        self.restart(seed, clock)

    def restart(self, seed: int, clock: int = 0) -> None:
        """Start anew with another seed and the clock at `clock`."""
        self.seed, self.clock = seed, clock
        self._write()

    def tick(self, steps: int = 1) -> None:
        """Advance the clock by `steps` steps."""
        self.clock += steps
        self._write()

    def at(self, envs: Tensor) -> "Noise":
        """Return a copy of the counter for environments `envs` [n] alone."""
        part = Noise(len(envs))
        part.renew(self, envs)
        return part

    def renew(self, whole: "Noise", envs: Tensor) -> None:
        """Write `whole.at(envs)` in place; of the same number of environments as this one."""
        self.keys.copy_(whole.keys[envs])
        self.restart(whole.seed, whole.clock)

    def _write(self) -> None:
        self._head[0], self._head[1] = as_i32(self.clock), as_i32(self.seed)


def as_i32(x: int) -> int:
    """Return x modulo 2^32 in the range of int32; the random numbers are the same."""
    return (x + 2**31) % 2**32 - 2**31


@ti.kernel
def _walk(value: array2, numbers: array1, count: whole1):
    ti.loop_config(serialize=runtime.loop.serial)
    for e in range(value.shape[0]):
        z = normal6(count[SEED], SLOW_VARIATION, count[KEY + e], 0, count[CLOCK])
        for a in ti.static(range(2)):
            value[e, a] = numbers[KEPT] * value[e, a] + numbers[ADDED] * z[a]


class Keys:
    """The keys of copies that draw noise of their own: none is handed out twice among a world, its forks and theirs.

    It is no state: a world that goes back to a snapshot does not draw the noise of its earlier copies again.
    """

    def __init__(self):
        """Begin above the number of any environment."""
        self._next = FIRST_FORKED

    def take(self, count: int) -> Tensor:
        """Keys [count] that nobody has had, int64."""
        first, self._next = self._next, self._next + count
        return torch.arange(first, self._next)

    def skip(self, used: Tensor) -> None:
        """Hand out only keys above those `used` elsewhere."""
        self._next = max(self._next, int(used.max()) + 1)


class SlowVariation(Remembers):
    """Slow random part of a current or a wind: a first-order Gauss-Markov process for each horizontal component.

    The step is the exact solution for any dt (Gelb 1974, Applied Optimal Estimation, sec. 3.8):

        v(t + dt) = phi v(t) + std sqrt(1 - phi^2) xi,   phi = exp(-dt / T),   xi standard normal.

    Attributes:
        value: north and east, [env, 2], m/s, in run precision; written in place.
        varies: whether `std` is above 0.
    """

    def __init__(self, num_envs: int, std: float, time_constant: float, *, seed: int, stream: int):
        """Begin at zero. `std` m/s, `time_constant` s; `stream` separates the random numbers from other uses."""
        run = runtime.current()
        self.varies, self._std, self._time, self._stream = std > 0, std, time_constant, stream
        self.value = self.remember(torch.zeros((num_envs, 2), dtype=run.torch_dtype, device=run.device))
        self._numbers, self._step = self.scratch(self.value.new_zeros(2)), self.scratch(0.0)
        self._noise = self.remember(Noise(num_envs))
        self._generator = self.share(torch.Generator(device=run.device))
        self._launch = runtime.Launcher(_walk)
        self.reseed(seed)

    def reseed(self, seed: int) -> None:
        """Make later draws depend on `seed` alone."""
        drawn = int(np.random.SeedSequence([seed, self._stream]).generate_state(1)[0])
        self._generator.manual_seed(drawn)
        self._noise.restart(drawn)

    def begin(self, envs: Tensor) -> None:
        """Draw environments `envs` (indices [n], int64) from the stationary distribution."""
        if self.varies:
            shape, device = (len(envs), 2), self.value.device
            normal = torch.randn(shape, generator=self._generator, dtype=self.value.dtype, device=device)
            self.value[envs] = self._std * normal

    def advance(self, dt: float) -> None:
        """Advance by `dt` (s), exactly."""
        if self.varies:
            if dt != self._step:
                decay = -dt / self._time
                self._step, self._numbers[KEPT] = dt, math.exp(decay)
                self._numbers[ADDED] = self._std * math.sqrt(-math.expm1(2 * decay))
            self._noise.tick()
            self._launch(self.value, self._numbers, self._noise.table)
