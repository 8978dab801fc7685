"""What `taichi-sim odds` prints and writes."""

import math
from typing import Any

import numpy as np

from rl.evaluation.odds.conditions import ratios
from rl.evaluation.odds.estimate import Answer
from rl.evaluation.odds.film import likeliest

TOLD = 8  # conditions in the text; all are in the JSON
HOUR = 3600.0  # s


def text(answer: Answer) -> str:
    """The odds as lines to read."""
    odds, question, pilot = answer.odds, answer.question, answer.pilot
    lines = [f"{question.team} {question.ending} in {question.config.name}, {question.controller}:"]
    lines += [f"  {line}" for line in (*_figure(answer), *_levels(answer))]
    hours = odds.cost * question.config.decision_interval / HOUR
    lines += [f"  simulated: {odds.cost:.3g} vehicle steps, {hours:.0f} vehicle hours, {odds.beginnings} beginnings"]
    if len(odds.levels) > 1 and odds.p > 0:
        steps = direct_cost(answer)
        lines += [
            f"  direct simulation needs {odds.direct(odds.relative):.3g} episodes, {steps:.3g} vehicle steps, for the "
            f"same standard error of {odds.relative:.0%}: {steps / odds.cost:.3g} times as many"
        ]
    if not pilot.branches:
        lines += ["  Nothing random happens after the start of an episode here: copies would all do the same."]
    lines += [f"  {line}" for line in _failures(answer)]
    if answer.interrupted is not None:
        lines += [f"  interrupted after {len(answer.parts)} repeats"]
    return "\n".join(lines)


def direct_cost(answer: Answer) -> float:
    """Vehicle steps that direct simulation needs for the same standard error."""
    odds, question = answer.odds, answer.question
    steps = answer.pilot.duration / question.config.decision_interval
    vehicles = sum(question.config.teams[name].count for name in question.policies)
    return odds.direct(odds.relative) * steps * vehicles


def _figure(answer: Answer) -> list[str]:
    odds, per_hour = answer.odds, HOUR / answer.pilot.duration
    seen = f"p = {odds.p:.3g} per episode"
    if odds.decided:
        return [
            f"no figure: {odds.ancestors} of {odds.beginnings} beginnings carry all failures (as much as "
            f"{odds.effective:.1f} equal ones): the failure is decided, wholly or in part, when an episode begins.",
            "Give --effort more paths, count episodes with --direct, or --set the conditions that it needs.",
        ]
    if not odds.p > 0 and len(odds.levels) > 1:
        return [
            f"no failure seen in {odds.beginnings} beginnings and their copies; those that a beginning decides have, "
            f"with 95 %, p below {3 / odds.beginnings:.2g}"
        ]
    if odds.low is None or odds.high is None:
        return [f"{seen}; one repeat has no interval"]
    return [
        f"{seen}, 95 % interval {odds.low:.3g} to {odds.high:.3g}",
        f"{odds.p * per_hour:.3g} per hour of the team ({odds.low * per_hour:.3g} to {odds.high * per_hour:.3g})",
        f"{odds.repeats} repeats; {odds.ancestors} of {odds.beginnings} beginnings carry it, as much as "
        f"{odds.effective:.0f} equal ones",
    ]


def _levels(answer: Answer) -> list[str]:
    odds = answer.odds
    if len(odds.levels) == 1:
        return [f"direct: {round(odds.p * odds.beginnings)} of {odds.beginnings} episodes"]
    names = (*(f"{level:.3g}" for level in odds.levels[:-1]), answer.question.ending)
    passed = ", ".join(f"{name}: {share:.0%}" for name, share in zip(names, odds.shares, strict=False))
    return [f"levels of importance, and the share that passed: {passed}"]


def _failures(answer: Answer) -> list[str]:
    moments = [part.moments for part in answer.parts]
    time, vehicle = (np.concatenate([getattr(each, key) for each in moments]) for key in ("time", "vehicle"))
    if not len(time):
        return []
    early, middle, late = np.quantile(time, (0.1, 0.5, 0.9))
    counts = np.bincount(vehicle) / len(vehicle)
    lines = [
        f"when: {middle:.0f} s after the start (80 %: {early:.0f} to {late:.0f} s); vehicle "
        + ", ".join(f"{k}: {share:.0%}" for k, share in enumerate(counts))
    ]
    clear = [one for one in ratios(answer.parts) if one.low > 1 or one.high < 1][:TOLD]
    if clear:
        lines += ["conditions that failures had more or less often than all episodes:"]
        lines += [
            f"  {one.ratio:5.2f} times ({one.low:.2f} to {one.high:.2f})  {one.condition}, {one.begins:.3g} to "
            f"{one.ends:.3g}"
            for one in clear
        ]
    return lines


def as_json(answer: Answer) -> dict[str, Any]:
    """All figures; what is unknown is null."""
    odds, question, pilot = answer.odds, answer.question, answer.pilot
    rate = HOUR / pilot.duration
    line = likeliest(answer)
    low, high = (None, None) if odds.decided else (odds.low, odds.high)
    return {
        "scenario": question.config.name,
        "team": question.team,
        "teams": list(question.policies),
        "ending": question.ending,
        "controller": question.controller,
        "seed": question.seed,
        "probability": None if odds.decided else odds.p,
        "low": low,
        "high": high,
        "per_hour": None if odds.decided else odds.p * rate,
        "decided_at_the_start": odds.decided or not pilot.branches,
        "levels": [level if math.isfinite(level) else question.ending for level in odds.levels],
        "shares": list(odds.shares),
        "repeats": [part.repeat.p for part in answer.parts],
        "effort": answer.effort,
        "beginnings": odds.beginnings,
        "ancestors": odds.ancestors,
        "effective_ancestors": odds.effective,
        "relative_standard_error": odds.relative if math.isfinite(odds.relative) else None,
        "vehicle_steps": odds.cost,
        "vehicle_steps_of_direct_simulation": direct_cost(answer) if odds.p > 0 else None,
        "episode_s": pilot.duration,
        "likeliest": None if line is None else line.as_json(),
        "conditions": [one._asdict() for one in ratios(answer.parts)],
        "complete": answer.interrupted is None,
    }
