"""Measure how far ahead a deck's motion can be forecast from its past, by sea state and heading to the waves.

    python tools/forecast.py VEHICLE [--sea-states 3 4 5 6] [--speed V] [--order N] [--out FILE] [--json FILE]

    python tools/forecast.py wamv --out wamv.png
    python tools/forecast.py fpso --sea-states 5 6 --roll 1.5

VEHICLE is a vessel's file, or the name of a shipped vessel, with a [deck]. The load of an ideal helm holds its --speed
(m/s) and heading. For each sea state and heading (0: waves from astern) it is simulated in --runs seas for --minutes.
Heave, roll, pitch and vertical velocity of the deck's centre are sampled each --interval s. An autoregressive model
(rl/guidance/forecast.py), one for each signal and run, learns online and forecasts them; forecasts of the second half
count. The skill at a horizon is

    1 - mean (forecast - truth)^2 / variance of the truth,

1 for an oracle that knows the sea, 0 for the mean. `persistence` forecasts no change. A window is quiescent if |roll|,
|pitch| and |vertical velocity| of the next --window s stay below --roll, --pitch (deg) and --heave (m/s). The table
gives its share of the time, the share of quiescent windows that are forecast, and the share of false forecasts.

Exit status: 0 done, 2 bad input.
"""

import argparse
import json
import math
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

import taichi_sim as ts
from rl.guidance.forecast import Autoregression
from taichi_sim.config import ConfigError
from taichi_sim.config.io import output
from taichi_sim.kernels import runtime
from taichi_sim.kernels.rotation import torch_quaternion_from_euler

SIGNALS = ("heave", "roll", "pitch", "vertical velocity")
UNITS = ("m", "rad", "rad", "m/s")
HEAVE, ROLL, PITCH, SPEED = range(4)
HORIZONS = (1, 2, 3, 4, 5, 6, 8, 10)  # s
HEADINGS = (0, 45, 90, 135, 180)  # deg, from the waves' direction of travel
DT, HELM = 0.02, 0.5  # physics step, s; rate at which the ideal helm restores heading and speed, 1/s
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")


class Skill(NamedTuple):
    """Results of one sea state and heading."""

    rms: NDArray[np.float64]  # [signal]
    model: NDArray[np.float64]  # [signal, horizon]
    persistence: NDArray[np.float64]  # [signal, horizon]
    window_share: float
    foretold: float  # share of quiescent windows that are forecast; NaN: there were none
    false_alarms: float  # share of forecast windows that are not quiescent


def motion(vehicle: str, state: int, heading_deg: float, args: argparse.Namespace) -> Tensor:
    """Simulate; return signals [sample, run, 4] of the deck's centre, float64."""
    config = ts.WorldConfig.model_validate({
        "dt": DT, "decision_interval": args.interval,
        "sea": {"sea_state": state, "direction_deg": 0.0, "components": 32, "realisations": args.runs},
        "boat": {"vehicle": vehicle, "count": 1},
    })  # fmt: skip
    world = ts.World(config, args.runs, seed=args.seed)
    boat, heading = world.teams["boat"], math.radians(heading_deg)
    deck = boat.model.deck
    if deck is None:
        raise ConfigError(f"{vehicle}: it has no [deck]")
    start = boat.state.new_zeros((args.runs, 1, 13))
    angle = start.new_full((args.runs, 1), heading)
    start[..., 3:7], start[..., 7] = torch_quaternion_from_euler(0 * angle, 0 * angle, angle), args.speed
    world.place("boat", torch.arange(args.runs), start)
    inertia = torch.linalg.inv(boat.model.mobility(boat))[0, 0].to(start)
    still, centre = torch.zeros_like(boat.action), start.new_tensor(deck.centre)
    found = []
    for _ in range(round(60 * args.minutes / args.interval)):
        c, s = boat.heading
        off = torch.atan2(math.sin(heading) * c - math.cos(heading) * s, math.cos(heading) * c + math.sin(heading) * s)
        u, r = boat.velocity_b[..., 0], boat.angular_velocity_b[..., 2]
        boat.load.zero_()
        boat.load[..., 0] = inertia[0, 0] * HELM * (args.speed - u)
        boat.load[..., 5] = inertia[5, 5] * (HELM * HELM * off - 2 * HELM * r)
        world.step({"boat": still})
        R = boat.R_nb
        arm = torch.linalg.cross(boat.angular_velocity_b, centre.expand_as(boat.angular_velocity_b), dim=-1)
        heave = -(boat.position_n + R @ centre)[..., 2] - deck.height
        fall = -(boat.velocity_n + (R @ arm.unsqueeze(-1)).squeeze(-1))[..., 2]
        found.append(torch.stack((heave, boat.euler[..., 0], boat.euler[..., 1], fall), dim=-1)[:, 0])
    return torch.stack(found).double()


def skill(signals: Tensor, args: argparse.Namespace) -> Skill:
    """Skill of forecasts of signals [sample, run, 4]."""
    steps = [round(h / args.interval) for h in HORIZONS]
    most, half = max(steps), len(signals) // 2
    mean = signals[:half].mean(dim=0)
    x = signals - mean
    model = Autoregression(x[0], args.order)
    window = round(args.window / args.interval)
    limits = x.new_tensor([math.inf, math.radians(args.roll), math.radians(args.pitch), args.heave])
    errors, kept, truth, told, came = [], [], [], [], []
    for k, sample in enumerate(x):
        model.learn(sample)
        if k >= half and k + most < len(x):
            ahead = model.predict(most)
            coming = torch.stack([x[k + n] for n in steps], dim=-1)
            errors.append((ahead[..., [n - 1 for n in steps]] - coming).square())
            kept.append((sample.unsqueeze(-1) - coming).square())
            truth.append(coming.square())
            told.append(_quiet(ahead[..., :window] + mean.unsqueeze(-1), limits))
            came.append(_quiet(signals[k + 1 : k + 1 + window].permute(1, 2, 0), limits))
    power = torch.stack(truth).mean(dim=(0, 1))
    of_model, of_none = (1 - torch.stack(e).mean(dim=(0, 1)) / power for e in (errors, kept))
    foretold, quiet = torch.stack(told), torch.stack(came)
    return Skill(
        x[half:].square().mean(dim=(0, 1)).sqrt().numpy(), of_model.numpy(), of_none.numpy(),
        float(quiet.double().mean()), float(foretold[quiet].double().mean()), float((~quiet[foretold]).double().mean()),
    )  # fmt: skip


def _quiet(signals: Tensor, limits: Tensor) -> Tensor:
    """Whether all samples [run, 4, n] are within the limits [4]: bool [run]."""
    return (signals.abs() < limits.unsqueeze(-1)).all(dim=-1).all(dim=-1)


def table(found: dict[int, dict[int, Skill]]) -> str:
    """Skill of vertical velocity and of windows as a readable table."""
    marks = [HORIZONS.index(h) for h in (2, 4, 6, 10)]
    lines = [
        "| sea state | heading | heave rms | roll, pitch rms | skill of vertical velocity at 2, 4, 6, 10 s | "
        "persistence at 2 s | windows | foretold | false |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for state, of_state in found.items():
        for heading, s in of_state.items():
            told = ", ".join(f"{s.model[SPEED, k]:.2f}" for k in marks)
            roll, pitch = np.degrees(s.rms[[ROLL, PITCH]])
            shares = ["-" if math.isnan(x) else f"{x:.0%}" for x in (s.window_share, s.foretold, s.false_alarms)]
            lines.append(
                f"| {state} | {heading} deg | {s.rms[HEAVE]:.2f} m | {roll:.1f}, {pitch:.1f} deg | {told} | "
                f"{s.persistence[SPEED, marks[0]]:.2f} | {' | '.join(shares)} |"
            )
    return "\n".join(lines)


def picture(found: dict[int, dict[int, Skill]], vehicle: str, out: Path) -> None:
    """Draw skill over horizon for each signal: a column for each sea state, a line for each heading."""
    from taichi_sim.visualisation.plotting import dress, new_figure

    figure = new_figure(2.6 * len(found) + 1.0, 8.6, f"Forecasts of the deck of {vehicle} from its own past")
    axes = figure.subplots(len(SIGNALS), len(found), squeeze=False, sharex=True, sharey=True)
    for column, (state, of_state) in enumerate(found.items()):
        for row, name in enumerate(SIGNALS):
            plot = axes[row, column]
            for k, (heading, s) in enumerate(of_state.items()):
                colour = COLOURS[k % len(COLOURS)] if k < len(COLOURS) else "#555555"
                plot.plot(HORIZONS, s.model[row], color=colour, linewidth=1.4, label=f"{heading} deg")
                if k == 0:
                    plot.plot(HORIZONS, s.persistence[row], color="#999999", linewidth=0.9, linestyle=":",
                              label="persistence")  # fmt: skip
            plot.axhline(0.0, color="#22313F", linewidth=0.6)
            plot.set_ylim(-0.5, 1.02)
            title = f"sea state {state}: {name}" if row == 0 else name
            dress(plot, title, "horizon (s)" if row == len(SIGNALS) - 1 else "", "skill" if column == 0 else "")
    axes[0, 0].legend(fontsize=7, frameon=False)
    figure.savefig(out, dpi=150)


def parser() -> argparse.ArgumentParser:
    """The arguments."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("vehicle")
    p.add_argument("--sea-states", type=int, nargs="+", default=[3, 4, 5, 6], choices=range(1, 9))
    p.add_argument(
        "--headings", type=float, nargs="+", default=list(HEADINGS), help="headings from the waves' course, deg"
    )
    p.add_argument("--speed", type=float, default=1.0, help="speed that is held, m/s")
    p.add_argument("--order", type=int, default=12, help="order of the model")
    p.add_argument("--interval", type=float, default=0.4, help="interval of samples, s, a multiple of 0.02")
    p.add_argument("--minutes", type=float, default=4.0)
    p.add_argument("--runs", type=int, default=16, help="seas for each sea state and heading")
    p.add_argument("--window", type=float, default=4.0, help="length of a quiescent window, s")
    p.add_argument("--roll", type=float, default=2.5, help="deg")
    p.add_argument("--pitch", type=float, default=1.5, help="deg")
    p.add_argument("--heave", type=float, default=1.0, help="m/s")
    p.add_argument("--seed", type=int, default=1)
    p.add_argument("--out", type=output, default=None, metavar="FILE", help="picture")
    p.add_argument("--json", type=output, default=None, metavar="FILE", help="all numbers")
    return p


def main(argv: list[str] | None = None) -> int:
    """Run the command."""
    args = parser().parse_args(argv)
    samples = round(60 * args.minutes / args.interval)
    if args.order < 1 or samples < 4 * args.order or samples * args.interval < 4 * max(HORIZONS):
        print(
            f"error: --minutes {args.minutes:g} are {samples} samples: a model of --order {args.order} needs at least "
            f"{max(4 * args.order, math.ceil(4 * max(HORIZONS) / args.interval))} (and an order at least 1)",
            file=sys.stderr,
        )
        return 2
    runtime.init()
    try:
        found = {
            state: {int(h): skill(motion(args.vehicle, state, h, args), args) for h in args.headings}
            for state in args.sea_states
        }
    except ConfigError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(table(found))
    if args.json:
        data = {
            state: {
                heading: {key: np.asarray(value).tolist() for key, value in s._asdict().items()}
                for heading, s in of_state.items()
            }
            for state, of_state in found.items()
        }
        told = {"vehicle": args.vehicle, "signals": SIGNALS, "horizons_s": HORIZONS, "skill": data}
        args.json.write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")
    if args.out:
        picture(found, args.vehicle, args.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
