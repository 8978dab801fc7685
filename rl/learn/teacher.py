"""A planner as a teacher: dataset aggregation (DAgger: Ross, Gordon & Bagnell 2011, AISTATS) before PPO goes on.

Round after round environments run, the planner says what it would do in each state that comes, and the network is
fitted to all that it has said so far. In the first round the planner acts, then the network does: so it is taught in
the states that it brings about itself.
"""

from typing import Any

import torch
from rsl_rl.models import MLPModel
from tensordict import TensorDict
from torch import Tensor
from tqdm import tqdm

from rl.planning.config import PlanConfig
from rl.planning.planner import Planner
from rl.scenario import TeacherConfig
from taichi_sim import runtime

BATCH = 2048  # labels in a step of the optimiser


def teach(
    mission: Any, team: str, actor: MLPModel, config: TeacherConfig, others: Any, *, seed: int, bar: tqdm
) -> list[float]:
    """Fit `actor` to what a planner would do for a team of `mission`; return the mean squared error after each round.

    Args:
        others: policies of the other teams, by name. bar: counts decisions.
    """
    own = mission.teams[team]
    plan = getattr(own.section, "plan", None) or PlanConfig()
    plan = plan.model_copy(update={"samples": config.samples, "rounds": 1})
    planner = Planner(plan, others, seed=seed, follow_mean=True)
    generator = torch.Generator().manual_seed(seed)
    seen: list[Tensor] = []
    labels: list[Tensor] = []
    losses = []
    for number in range(config.rounds):
        for _ in range(config.decisions):
            with torch.no_grad(), runtime.torch_at_rest():
                planned = planner(own)
                observed = own.observe()
                seen.append(observed.flatten(0, 1).float())
                labels.append(own.correction_for(planner.correction()).flatten(0, 1).float())
                action = planned if number == 0 else own.command(_acted(actor, observed))
                joint = {name: policy(mission.teams[name]) for name, policy in others.items()}
                step = mission.step({**joint, team: action})
                mission.reset((step.terminated | step.truncated).nonzero().squeeze(1))
            bar.update(1)
        losses.append(_fit(actor, torch.cat(seen), torch.cat(labels), config, generator))
        bar.set_postfix(error=f"{losses[-1]:.4f}")
    return losses


def _acted(actor: MLPModel, observed: Tensor) -> Tensor:
    """Mean actions [env, vehicle, a] of the network."""
    rows = observed.flatten(0, 1).float()
    return actor(TensorDict({"policy": rows}, batch_size=[len(rows)])).view(*observed.shape[:2], -1).clamp(-1.0, 1.0)


def _fit(actor: MLPModel, seen: Tensor, labels: Tensor, config: TeacherConfig, generator: torch.Generator) -> float:
    """Fit the network to labels [row, a] of observations [row, n]; the mean squared error of the last epoch."""
    weights = [p for name, p in actor.named_parameters() if "distribution" not in name]
    steps = max(1, len(seen) // BATCH)
    optimizer = torch.optim.Adam(weights, config.learning_rate)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, config.epochs * steps)
    error = 0.0
    for _ in range(config.epochs):
        error = 0.0
        for rows in torch.randperm(len(seen), generator=generator)[: steps * BATCH].chunk(steps):
            loss = (actor(TensorDict({"policy": seen[rows]}, batch_size=[len(rows)])) - labels[rows]).square().mean()
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            schedule.step()
            error += float(loss.detach()) / steps
    return error
