"""The likeliest failure as a recording: its repeat runs again, to the bit, and the frames of one line are kept."""

from collections.abc import Mapping
from typing import NamedTuple

from rl.evaluation.episode_recording import EpisodeReel, events_of
from rl.evaluation.odds.estimate import Answer, Question, slots_for
from rl.evaluation.odds.splitting import HAPPENED, Ints, repeat
from rl.mission import Step
from rl.runs.folder import RunError
from taichi_sim.visualisation.recording import Episode, Event


class Line(NamedTuple):
    """One failure, from its beginning on."""

    repeat: int  # number of its repeat
    runs: Mapping[int, int]  # number of a run -> its path
    levels: tuple[float, ...]
    effort: int

    def as_json(self) -> dict:
        """The line as JSON."""
        runs = {str(run): path for run, path in self.runs.items()}
        return {"repeat": self.repeat, "runs": runs, "levels": self.levels[:-1], "effort": self.effort}

    @classmethod
    def of_json(cls, given: Mapping) -> "Line":
        """The line that `as_json` wrote."""
        runs = {int(run): path for run, path in given["runs"].items()}
        return cls(given["repeat"], runs, (*given["levels"], HAPPENED), given["effort"])


def likeliest(answer: Answer) -> Line | None:
    """The failure that stems from the beginning that carries most; None: there is none."""
    part = max(answer.parts, key=lambda part: part.repeat.weights.max())
    if not part.repeat.p > 0:
        return None
    runs = part.repeat.lineage(part.repeat.likeliest)
    return Line(part.number, runs, answer.pilot.levels.levels, answer.effort)


class _HappenedError(Exception):
    """The failure has happened."""


def record(question: Question, line: Line) -> Episode:
    """Run a failure again and record it."""
    paths = question.paths(line.repeat, lambda _: None, slots_for(line.levels, line.effort))
    interval, reel = question.config.decision_interval, None
    known: set[tuple[str, int, str]] = set()
    events: list[Event] = []

    def watch(run: int, at: Ints, envs: Ints, step: Step) -> None:
        nonlocal reel
        found = envs[at == line.runs.get(run, -1)]
        if not len(found):
            return
        env = int(found[0])
        reel = reel or EpisodeReel(paths.mission, env, interval)
        reel.env = reel.recorder.env = env
        reel.add(step)
        events.extend(events_of(step, reel.now, known, paths.mission.Judge.goals, env))
        if bool(step.endings[question.team][question.ending][env].any()):
            raise _HappenedError

    paths.watch = watch
    try:
        repeat(paths, line.levels, line.effort, question.rng(line.repeat))
    except _HappenedError:
        assert reel is not None
        return reel.episode(events=events, name=f"{question.team} {question.ending}")
    raise RunError(f"repeat {line.repeat} had no such failure: its scenario, policy or program was another")
