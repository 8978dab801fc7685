"""Forecasts of a deck's motion from its own past: an autoregressive model by recursive least squares.

The model of an evenly sampled signal x is

    x[k] = a_1 x[k-1] + ... + a_n x[k-n] + e[k].

Recursive least squares (Ljung 1999, System Identification, sec. 11.2) learns the coefficients from the samples and
forgets the past by the factor lambda per sample. The prediction h samples ahead is the model, run on. Coefficients
learnt from few samples may be unstable, so predictions are limited to `MOST` times the signal's root mean square.
Everything is batched: there is one model for each element of a tensor.
"""

import torch
from torch import Tensor

from taichi_sim.state.memory import Remembers

FORGETTING = 0.998  # lambda; assumed
PRIOR = 1e3  # prior variance of the coefficients over that of the error; assumed
MOST = 3.0  # largest prediction over the root mean square of all samples; assumed
FEWEST = 2.0  # samples over the order, from which a model is ready; assumed


class Autoregression(Remembers):
    """Models of order n of signals of any shape [...].

    Attributes:
        coefficients: [..., n].
        past: [..., n], the newest sample first.
        count: [...], number of samples learnt from.
    """

    def __init__(self, like: Tensor, order: int, forgetting: float = FORGETTING, prior: float = PRIOR):
        """Make models of signals of the shape of `like` [...]."""
        if order < 1:
            raise ValueError(f"order = {order}: must be at least 1")
        self.order, self._forgetting, self._prior = order, forgetting, prior
        self.coefficients = self.remember(like.new_zeros((*like.shape, order)))
        self.past = self.remember(like.new_zeros((*like.shape, order)))
        self.count, self._power = (self.remember(torch.zeros_like(like)) for _ in range(2))
        begun = prior * torch.eye(order, dtype=like.dtype, device=like.device)
        self._covariance = self.remember(begun.repeat(*like.shape, 1, 1))

    def begin(self, which: Tensor) -> None:
        """Forget everything in rows `which` [n] of the first axis."""
        for memory in (self.coefficients, self.past, self.count, self._power):
            memory[which] = 0.0
        eye = torch.eye(self.order, dtype=self.past.dtype, device=self.past.device)
        self._covariance[which] = self._prior * eye

    @property
    def ready(self) -> Tensor:
        """Bool [...]: whether there are enough samples for a forecast."""
        return self.count >= (1.0 + FEWEST) * self.order

    def learn(self, sample: Tensor, where: Tensor | None = None) -> None:
        """Learn from the next sample [...], where `where` (bool, broadcast to [...]) is true."""
        x, P = self.past.unsqueeze(-1), self._covariance
        Px = P @ x
        gain = Px / (self._forgetting + (x.mT @ Px))
        error = sample - (self.coefficients * self.past).sum(-1)
        coefficients = self.coefficients + gain.squeeze(-1) * error.unsqueeze(-1)
        covariance = (P - gain @ Px.mT) / self._forgetting
        covariance = 0.5 * (covariance + covariance.mT)
        full = self.count >= self.order
        on = torch.ones_like(full) if where is None else where.expand_as(full)
        learns = (full & on).unsqueeze(-1)
        self.coefficients = torch.where(learns, coefficients, self.coefficients)
        self._covariance = torch.where(learns.unsqueeze(-1), covariance, P)
        past = torch.cat((sample.unsqueeze(-1), self.past[..., :-1]), dim=-1)
        self.past = torch.where(on.unsqueeze(-1), past, self.past)
        self.count = self.count + on
        power = self._power + (sample.square() - self._power) / self.count.clamp(min=1.0)
        self._power = torch.where(on, power, self._power)

    def predict(self, steps: int) -> Tensor:
        """The next `steps` samples [..., steps]."""
        past, found, most = self.past, [], MOST * self._power.sqrt().unsqueeze(-1)
        for _ in range(steps):
            new = (self.coefficients * past).sum(-1, keepdim=True)
            new = torch.minimum(torch.maximum(new, -most), most)
            found.append(new)
            past = torch.cat((new, past[..., :-1]), dim=-1)
        return torch.cat(found, dim=-1)
