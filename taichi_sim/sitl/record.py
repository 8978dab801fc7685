"""A recording (rerun) of what an autopilot drives: a file for each life of the vehicle, from frame 0 to a restart."""

from pathlib import Path
from typing import cast

from torch import Tensor

from taichi_sim.config import WorldConfig
from taichi_sim.fleet import Fleet
from taichi_sim.recording import Recorder
from taichi_sim.sea import Sea
from taichi_sim.sitl.craft import Craft
from taichi_sim.sitl.packets import Sensors, Servos
from taichi_sim.surroundings import Surroundings
from taichi_sim.world import World

RATE = 10.0  # recorded frames a second, at most


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


class Reel:
    """Keeps frames, and writes them to `file`; those after a restart to a file beside it, -2, -3 and so on."""

    def __init__(self, file: Path, craft: Craft):
        """Nothing is kept yet."""
        self.file, self.craft, self.lives, self.due = file, craft, 0, 0.0
        self.stage = Stage(craft)
        self.recorder: Recorder | None = None

    def see(self, servos: Servos, sensors: Sensors) -> None:
        """Keep this frame, if it is time for one (`Session.seen`)."""
        if self.craft.frames == 1:  # it has just begun
            self.write()
            self.recorder = Recorder(cast(World, self.stage), after=sensors.timestamp)
            self.lives, self.due = self.lives + 1, 0.0
        if self.recorder is not None and sensors.timestamp >= self.due:
            self.recorder.add({self.stage.name: self.craft.bench.fleet.action})
            self.due = sensors.timestamp + 1 / RATE - 1e-6

    def write(self) -> Path | None:
        """Write the file of the present life; None if nothing was kept."""
        if self.recorder is None or not len(self.recorder):
            return None
        file = self.file if self.lives == 1 else self.file.with_stem(f"{self.file.stem}-{self.lives}")
        told = f"# {self.stage.name}\n\nDriven by an autopilot at {self.craft.rate} Hz, from frame 0 on.\n"
        self.recorder.write(file, name=self.stage.name, config_text=told)
        self.recorder = None
        return file
