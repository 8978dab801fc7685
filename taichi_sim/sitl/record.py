"""Recordings and a live view (rerun) of what an autopilot drives, from frame 0 to a restart."""

from pathlib import Path
from typing import cast

from torch import Tensor

from taichi_sim.config import WorldConfig
from taichi_sim.fleet import Fleet
from taichi_sim.recording import Recorder
from taichi_sim.recording.live import Live
from taichi_sim.sea import Sea
from taichi_sim.sitl.craft import Craft
from taichi_sim.sitl.packets import Sensors, Servos
from taichi_sim.surroundings import Surroundings
from taichi_sim.world import World

RATE = 10.0  # recorded frames a second, at most
FIRST, PART = 30, 5  # frames of the first part of a live view, by which it is laid out, and of each later one


class Stage:
    """What a Recorder reads of a world, of a craft's bench, which is another one after a change of the frame rate."""

    num_envs = 1

    def __init__(self, craft: Craft):
        """Of `craft`, which has begun."""
        self.craft, self.name = craft, Path(craft.vehicle).stem
        self.config = WorldConfig(name=self.name)

    @property
    def teams(self) -> dict[str, Fleet]:
        """The one vehicle."""
        return {self.name: self.craft.bench.fleet}

    @property
    def sea(self) -> Sea:
        """Its sea."""
        return self.craft.bench.sea

    @property
    def time(self) -> Tensor:
        """[1] s."""
        return self.craft.bench.time

    @property
    def around(self) -> Surroundings:
        """Its surroundings."""
        return self.craft.bench.around

    @property
    def env_sea(self) -> Tensor:
        """[1] realisation of the sea."""
        return self.around.env_sea

    def elevation(self, envs: Tensor, north: Tensor, east: Tensor) -> Tensor:
        """Elevation (m, up) now at points [1, point], shaped like them."""
        points = north.new_empty((north.numel(), 2))
        points[:, 0], points[:, 1] = north[0], east[0]
        phase = self.sea.phases(self.env_sea, self.time)
        rows = self.env_sea.new_zeros(len(points))
        return self.sea.elevation_at(points, rows, self.env_sea, phase).view(north.shape)


class Frames:
    """Frames of a craft, RATE a second, from its begin on."""

    def __init__(self, craft: Craft):
        """None yet."""
        self.craft, self.stage, self.due = craft, Stage(craft), 0.0
        self.recorder: Recorder | None = None

    def begin(self, sensors: Sensors) -> None:
        """The craft has just begun: forget what was before."""
        self.recorder, self.due = Recorder(cast(World, self.stage), after=sensors.timestamp), 0.0

    def take(self, sensors: Sensors) -> None:
        """Take a frame, if it is time for one."""
        if self.recorder is not None and sensors.timestamp >= self.due:
            self.recorder.add({self.stage.name: self.craft.bench.fleet.action})
            self.due = sensors.timestamp + 1 / RATE - 1e-6

    def __len__(self) -> int:
        """Number of frames."""
        return 0 if self.recorder is None else len(self.recorder)

    @property
    def parts(self) -> dict[str, str]:
        """Name and description of what is recorded."""
        told = f"# {self.stage.name}\n\nDriven by an autopilot at {self.craft.rate} Hz, from frame 0 on.\n"
        return {"name": self.stage.name, "config_text": told}


class Reel:
    """Keeps frames, and writes them to `file`; those after a restart to a file beside it, -2, -3 and so on."""

    def __init__(self, file: Path, craft: Craft):
        """Nothing is kept yet."""
        self.file, self.frames, self.lives = file, Frames(craft), 0

    def see(self, servos: Servos, sensors: Sensors) -> None:
        """Keep this frame, if it is time for one (`Session.seen`)."""
        if self.frames.craft.frames == 1:  # it has just begun
            self.write()
            self.frames.begin(sensors)
            self.lives += 1
        self.frames.take(sensors)

    def write(self) -> Path | None:
        """Write the file of the present life; None if nothing was kept."""
        recorder, self.frames.recorder = self.frames.recorder, None
        if recorder is None or not len(recorder):
            return None
        file = self.file if self.lives == 1 else self.file.with_stem(f"{self.file.stem}-{self.lives}")
        recorder.write(file, **self.frames.parts)
        return file


class View:
    """Shows frames live, half a second at a time; after a restart, its clock goes on."""

    def __init__(self, live: Live, craft: Craft):
        """Nothing is shown yet."""
        self.live, self.frames, self.after, self.last = live, Frames(craft), 0.0, 0.0

    def see(self, servos: Servos, sensors: Sensors) -> None:
        """Show this frame, with those about it (`Session.seen`)."""
        if self.frames.craft.frames == 1:  # it has just begun
            if self.frames.recorder is not None:
                self.live.begin()
            self.after += self.last
            self.frames.begin(sensors)
        self.last = sensors.timestamp
        self.frames.take(sensors)
        if self.frames.recorder is not None and len(self.frames) >= (FIRST if self.live.like is None else PART):
            part = self.frames.recorder.part(like=self.live.like, **self.frames.parts)
            self.live.show(part, after_s=self.after)
