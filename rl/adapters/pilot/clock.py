"""The companion's clock: the machine's, or that of simulated autopilots, which may run slower or faster.

A simulated autopilot (ArduPilot's SITL tells `SIM_SPEEDUP`) is as slow as its simulation. Time is then what the first
vehicle's messages say, and goes on at their pace between them, so that decisions, ages and limits are in seconds of the
simulation. The clock of a real autopilot runs like ours.
"""

from collections import deque

WINDOW = 3.0  # s, over which a pace is measured
ENOUGH = 0.5  # s, less is not measured
APART = 1.0  # s; a clock that is further behind ours has begun anew, or has stood still


class Pace:
    """How fast one clock runs against another.

    Attributes:
        value: seconds of the first for each of the second; 1 until it is known.
    """

    def __init__(self):
        """Nothing is known."""
        self.value = 1.0
        self._marks: deque[tuple[float, float]] = deque()

    def __call__(self, now: float, stamp: float) -> None:
        """Take what one clock shows (`stamp`, s) where the other shows `now` (s)."""
        if self._marks and stamp <= self._marks[-1][1]:
            if stamp > self._marks[-1][1] - APART:
                return
            self._marks.clear()
        self._marks.append((now, stamp))
        while now - self._marks[0][0] > WINDOW and len(self._marks) > 2:
            self._marks.popleft()
        begun, first = self._marks[0]
        if now - begun > ENOUGH:
            self.value = (stamp - first) / (now - begun)


class Clock:
    """Time of the companion, s: the machine's until a simulated autopilot is heard.

    Attributes:
        pace: seconds of it for each of the machine's.
    """

    def __init__(self, real: float):
        """Begin as the machine's clock, which shows `real` (s)."""
        self._pace = Pace()
        self._shown = self._base = self._real = real
        self._offset: float | None = None  # of this clock over the autopilot's, s

    @property
    def pace(self) -> float:
        """As above."""
        return 1.0 if self._offset is None else self._pace.value

    def __call__(self, real: float) -> float:
        """Time where the machine's clock shows `real` (s); it never goes back."""
        self._shown = max(self._shown, self._base + self.pace * (real - self._real))
        return self._shown

    def follow(self, real: float, stamp: float) -> None:
        """Follow a simulated autopilot, whose newest message says `stamp` (s) and came at `real` (s)."""
        now = self(real)
        self._pace(real, stamp)
        if self._offset is None or now - (self._offset + stamp) > APART:
            self._offset = now - stamp
        self._base, self._real = self._offset + stamp, real
