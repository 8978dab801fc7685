"""Live views (taichi_sim/visualisation/recording/live.py) of an episode that is played, and of a training.

A view changes nothing in the simulation: it reads the shown environment between steps. The view of a training shows a
few seconds of motion in real time and then pauses, so that it takes at most a set share of the training's time. Its
clock counts real time since the training began, for motion and curves.
"""

import contextlib
import sys
import time
from collections.abc import Iterator, Mapping

import torch

from rl.evaluation.episode_recording import EpisodeReel
from rl.mission import Mission, Step
from taichi_sim.visualisation.recording import Event
from taichi_sim.visualisation.recording.live import PORT, Live, refuse_used

__all__ = ["EpisodeView", "TrainingView", "episode_view", "refuse_used", "training_view"]

STAGE_S = 4.0  # first piece of motion; it sets scales and layout
PIECE_S = 0.2  # motion sent at a time
LATE_S = 0.5  # a view that lags more than this stops catching up
SHARE = 0.05  # most of a training's time that its view may take
POINT_S = 1.0  # least time between two points of a training's curves


class EpisodeView:
    """Shows an episode while it is simulated, at `speed` times real time or slower if the simulation is slower."""

    def __init__(self, live: Live, speed: float = 1.0) -> None:
        """Connect to a live view; the first frame comes later."""
        self.live, self.speed = live, speed
        self._reel: EpisodeReel | None = None
        self._events: list[Event] = []
        self._zero = 0.0  # time.monotonic at the start of the episode
        self._shown = 0.0  # s of the episode shown so far

    def __call__(self, mission: Mission, env: int, step: Step, events: list[Event]) -> None:
        """Show environment `env` after a step."""
        dt = mission.config.decision_interval
        if self._reel is None:
            self._reel = EpisodeReel(mission, env, dt)
        reel, now = self._reel, self._reel.now
        reel.add(step)
        self._events += events
        if self.live.like is None:
            if now - self._shown < STAGE_S:
                return
            self._zero = time.monotonic() - now / self.speed
        due, late = self._zero + now / self.speed, time.monotonic() - LATE_S
        if due < late:
            self._zero, due = self._zero + late - due, late
        time.sleep(max(0.0, due - time.monotonic()))
        if now - self._shown >= self.speed * PIECE_S - 0.5 * dt:
            self.finish()

    def finish(self) -> None:
        """Show the frames that are not shown yet."""
        if self._reel is not None and len(self._reel):
            self._shown = self._reel.now
            self.live.show(self._reel.part(events=self._events, like=self.live.like))
            self._events = []


class TrainingView:
    """Shows environment 0 of a training, which calls it after each step."""

    def __init__(self, live: Live) -> None:
        """Connect to a live view; the first step comes later."""
        self.live, self._off = live, False
        self._begun, self._steps = time.monotonic(), 0
        self._mission: Mission | None = None
        self._reel: EpisodeReel | None = None
        self._rolling = False
        self._next = 0.0  # time.monotonic when motion is shown again
        self._at, self._from, self._cost = 0.0, 0.0, 0.0  # shown motion: time.monotonic, simulated time, cost
        self._sums: dict[str, dict[str, tuple[torch.Tensor, int]]] = {}
        self._point = self._begun

    def __call__(self, mission: Mission, step: Step, logs: Mapping[str, Mapping[str, torch.Tensor]]) -> None:
        """Take a training step; `logs` holds what each team logs. An error ends the view, not the training."""
        if self._off:
            return
        begin = time.perf_counter()
        try:
            self._plot(logs)
            self._update(mission, step)
        except Exception as error:  # the training goes on after any error
            print(f"--watch has stopped: {type(error).__name__}: {error}", file=sys.stderr)
            self._off = True
        self._cost += time.perf_counter() - begin

    def _update(self, mission: Mission, step: Step) -> None:
        if mission is not self._mission:  # another stage, maybe with other teams
            if self._mission is not None:
                self.live.begin(anew=True)
            self._mission, self._reel, self._rolling = mission, None, False
        dt, ended = mission.config.decision_interval, bool((step.terminated | step.truncated)[0])
        if not self._rolling and time.monotonic() >= self._next:
            self._roll(mission, dt)
        if self._rolling and self._reel is not None:
            reel = self._reel
            if not ended:  # what is there now has begun anew
                reel.add(step)
            over = ended or reel.now - self._from >= STAGE_S
            piece = self.live.like is not None and len(reel) * dt >= PIECE_S - 0.5 * dt
            if len(reel) and (over or piece):
                self._show(reel)
            if over:
                self._rolling = False
                self._next = max(self._at + reel.now - self._from, time.monotonic() + self._cost / SHARE)
        if ended:
            self._reel = None

    def _roll(self, mission: Mission, dt: float) -> None:
        """Begin to show motion, of the same episode as before or of a new one."""
        if self._reel is None:
            self.live.begin()
            self._reel = EpisodeReel(mission, after=dt)
        self._rolling, self._cost = True, 0.0
        self._at, self._from = time.monotonic(), self._reel.now

    def _show(self, reel: EpisodeReel) -> None:
        part = reel.part(like=self.live.like)
        at = 0.0 if self.live.like is None else self._at + float(part.time_s[0]) - self._from
        self.live.show(part, after_s=self._at - self._begun - self._from, at=at)

    def _plot(self, logs: Mapping[str, Mapping[str, torch.Tensor]]) -> None:
        """Plot means of the logged values since the last point: a plot for each name, a line for each team."""
        self._steps += 1
        for team, log in logs.items():
            for key, value in log.items():
                lines = self._sums.setdefault(key.lstrip("/"), {})
                total, count = lines.get(team, (torch.zeros_like(value), 0))
                lines[team] = (total + value, count + 1)
        now = time.monotonic()
        if now - self._point < POINT_S and self._steps > 1:
            return
        self._point = now
        for name, lines in self._sums.items():
            means = {team: float(total.mean()) / count for team, (total, count) in lines.items()}
            self.live.plot(name, means, now - self._begun, ("decision", self._steps))
        self._sums = {}


@contextlib.contextmanager
def episode_view(wanted: bool, port: int = PORT, speed: float = 1.0) -> Iterator[EpisodeView | None]:
    """The view for `play --live`, or None if not wanted."""
    if not wanted:
        yield None
        return
    with Live("play", port=port) as live:
        print(live.told, flush=True)
        follow = EpisodeView(live, speed)
        yield follow
        follow.finish()


@contextlib.contextmanager
def training_view(wanted: bool, port: int = PORT) -> Iterator[TrainingView | None]:
    """The view for `train --watch`, or None if not wanted."""
    if not wanted:
        yield None
        return
    with Live("training", port=port, everywhere=True) as live:
        print(live.told, flush=True)
        yield TrainingView(live)
