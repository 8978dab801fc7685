"""Recordings and live views (rerun) of a vehicle that an autopilot drives.

A recording runs from frame 0 to a restart.
"""

from pathlib import Path
from typing import cast

from torch import Tensor

from taichi_sim.applications.sitl.craft import Craft, Servos
from taichi_sim.applications.sitl.driven import Sensors
from taichi_sim.config import WorldConfig
from taichi_sim.fleet import Fleet
from taichi_sim.surroundings.around_vehicles import Surroundings
from taichi_sim.surroundings.sea import Sea
from taichi_sim.vehicle import Vehicle
from taichi_sim.visualisation.recording import Recorder
from taichi_sim.visualisation.recording.live import Live
from taichi_sim.visualisation.recording.recorder import EpisodeParts
from taichi_sim.world import World

RATE = 10.0  # largest number of recorded frames per second
FIRST, PART = 30, 5  # frames of a live view's first part, which sets its layout; frames of a later part


class Stage:
    """The parts of a World that a Recorder reads, taken from a craft's bench.

    The bench changes with the frame rate, so each property asks the craft anew.
    """

    num_envs = 1

    def __init__(self, craft: Craft):
        """Read `craft`, which has begun."""
        self.craft, self.name = craft, Path(craft.vehicle).stem
        self.config = WorldConfig(name=self.name)

    @property
    def teams(self) -> dict[str, Fleet[Vehicle]]:
        """The fleet of the one vehicle, by its name."""
        return {self.name: self.craft.bench.fleet}

    @property
    def sea(self) -> Sea:
        """The sea of the bench."""
        return self.craft.bench.sea

    @property
    def time(self) -> Tensor:
        """Time [1], s."""
        return self.craft.bench.time

    @property
    def around(self) -> Surroundings:
        """Surroundings of the vehicle."""
        return self.craft.bench.around

    @property
    def env_sea(self) -> Tensor:
        """Realisation of the sea [1]."""
        return self.around.env_sea

    elevation = World.elevation


class Frames:
    """Recorded frames of a craft since its beginning, RATE per second."""

    def __init__(self, craft: Craft):
        """Start without frames."""
        self.craft, self.stage, self.due = craft, Stage(craft), 0.0
        self.recorder: Recorder | None = None

    def begin(self, sensors: Sensors) -> None:
        """Drop earlier frames, because the craft has just begun."""
        self.recorder, self.due = Recorder(cast(World, self.stage), after=sensors.timestamp), 0.0

    def take(self, sensors: Sensors) -> None:
        """Record a frame if it is due."""
        if self.recorder is not None and sensors.timestamp >= self.due:
            self.recorder.add({self.stage.name: self.craft.bench.fleet.action})
            self.due = sensors.timestamp + 1 / RATE - 1e-6

    def __len__(self) -> int:
        """Number of frames."""
        return 0 if self.recorder is None else len(self.recorder)

    @property
    def parts(self) -> EpisodeParts:
        """Name and description of the recording."""
        text = f"# {self.stage.name}\n\nDriven by an autopilot at {self.craft.rate} Hz, from frame 0 on.\n"
        return {"name": self.stage.name, "config_text": text}


class CraftRecording:
    """Records frames and writes them to `file`; frames after a restart go to files beside it, -2, -3 and so on."""

    def __init__(self, file: Path, craft: Craft):
        """Start without frames."""
        self.file, self.frames, self.lives = file, Frames(craft), 0

    def see(self, servos: Servos, sensors: Sensors) -> None:
        """Record this frame if it is due (one of `Session.seen`)."""
        if self.frames.craft.frames == 1:  # it has just begun
            self.write()
            self.frames.begin(sensors)
            self.lives += 1
        self.frames.take(sensors)

    def write(self) -> Path | None:
        """Write the file of the frames since the last restart; return None if there are none."""
        recorder, self.frames.recorder = self.frames.recorder, None
        if recorder is None or not len(recorder):
            return None
        file = self.file if self.lives == 1 else self.file.with_stem(f"{self.file.stem}-{self.lives}")
        recorder.write(file, **self.frames.parts)
        return file


class CraftView:
    """Shows frames live, half a second at a time. Its clock continues after a restart."""

    def __init__(self, live: Live, craft: Craft):
        """Start without frames."""
        self.live, self.frames, self.after, self.last = live, Frames(craft), 0.0, 0.0

    def see(self, servos: Servos, sensors: Sensors) -> None:
        """Show this frame together with its neighbours (one of `Session.seen`)."""
        if self.frames.craft.frames == 1:  # it has just begun
            if self.frames.recorder is not None:
                self.live.begin()
            self.after += self.last
            self.frames.begin(sensors)
        self.last = sensors.timestamp
        self.frames.take(sensors)
        if self.frames.recorder is not None and len(self.frames) >= (FIRST if self.live.like is None else PART):
            part = self.frames.recorder.part(**self.frames.parts | {"like": self.live.like})
            self.live.show(part, after_s=self.after)
