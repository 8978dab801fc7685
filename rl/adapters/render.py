"""Pictures of a mission while it runs, for `render` of Gymnasium and PettingZoo.

Each picture is drawn (taichi_sim/visualisation/film/) from an episode of one frame. Only the vehicles' trails are kept
from step to step, for all environments. Drawing uses no random number and changes nothing in the mission, so that a
rollout has the same bits with and without pictures.

A picture of 640x480 takes 14 to 20 ms on two cores. Each environment adds a few ms, however small its picture is.
"""

from collections import deque

import numpy as np
import torch
from gymnasium import logger
from numpy.typing import NDArray

from rl.mission import Mission
from taichi_sim.visualisation.film.draw import Cast
from taichi_sim.visualisation.film.moment import TRAIL_POINTS, TRAIL_S, Moment, moment_of
from taichi_sim.visualisation.film.picture import Picture, check_picture
from taichi_sim.visualisation.recording import Recorder, Scene

MODES = ["rgb_array", "human"]
SIZES = ((1, (640, 480)), (4, (320, 240)), (16, (240, 180)))  # up to this many environments: px
SMALLEST = (160, 120)
NO_WINDOWS = ("agg", "cairo", "pdf", "pgf", "ps", "svg", "template")  # backends of matplotlib


def frames_per_second(decision_interval: float) -> int:
    """Pictures per second if each decision gives one."""
    return max(1, round(1.0 / decision_interval))


def picture_size(num_envs: int) -> tuple[int, int]:
    """Default width and height of each environment's picture, px."""
    return next((size for most, size in SIZES if num_envs <= most), SMALLEST)


class Pictures:
    """Draws a picture of each environment of a mission."""

    def __init__(self, task: Mission, size: tuple[int, int] | None = None, mode: str | None = "rgb_array") -> None:
        """Draw `task`, whose vehicles are at the start of an episode.

        Args:
            task: the mission.
            size: width and height of each environment's picture, px; the default depends on the number of environments.
            mode: "rgb_array", "human" for a window, or None: nothing is drawn.
        """
        if mode not in (None, *MODES):
            raise ValueError(f"render_mode = {mode!r}: allowed are None, {', '.join(map(repr, MODES))}")
        self.task, self.size, self.mode = task, size or picture_size(task.num_envs), mode
        if mode is not None:
            check_picture(self.size, "auto", None)
        self._window = _Window() if mode == "human" else None
        self._cast, self._pictures = Cast(), {}
        interval = task.config.decision_interval
        self._every = max(1, round(TRAIL_S / interval / TRAIL_POINTS))  # decisions between two points of a trail
        self._trails: deque[tuple[torch.Tensor, dict[str, torch.Tensor]]] = deque(maxlen=TRAIL_POINTS)
        self._kept = 0

    def keep(self) -> None:
        """Extend the trails; call this after each step and reset. In mode "human", also update the window."""
        if self.mode is None:
            return
        if self._kept % self._every == 0:
            teams = {name: fleet.position_n.clone() for name, fleet in self.task.world.teams.items()}
            self._trails.append((self.task.steps.clone(), teams))
        self._kept += 1
        if self._window is not None:
            self._window.show(tiled(self.draw()))

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """Draw all environments (see `draw`); return None unless the mode is "rgb_array"."""
        if self.mode is None:
            logger.warn("render() draws nothing: the environment was made without a render_mode")
        return self.draw() if self.mode == "rgb_array" else None

    def draw(self) -> tuple[NDArray[np.uint8], ...]:
        """A picture [high, wide, 3] of each environment as it is now."""
        return tuple(self._picture(env) for env in range(self.task.num_envs))

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._window is not None:
            self._window.close()

    def _picture(self, env: int) -> NDArray[np.uint8]:
        moment = self._moment(env)
        if env not in self._pictures:
            self._pictures[env] = Picture(moment, self.size, cast=self._cast)
        return self._pictures[env].paint(moment)

    def _moment(self, env: int) -> Moment:
        """The present moment of environment `env`, with trails."""
        task, frame = self.task, self.task.frame(env)
        mission = {
            name: {key: value.detach().cpu().numpy()[None] for key, value in row.items()}
            for name, row in frame.teams.items()
        }
        recorder = Recorder(task.world, env)
        recorder.add()
        episode = recorder.episode(
            mission=mission, scene=task.scene(env) or Scene(), overlays=frame.overlays, config_text=""
        )
        moment = moment_of(episode, 0.0)
        trails = self._trail(env)
        teams = {
            name: team._replace(trail_n=np.concatenate([trails[name], team.position_n[None]]))
            for name, team in moment.teams.items()
        }
        return moment._replace(teams=teams, time_s=float(task.steps[env]) * task.config.decision_interval)

    def _trail(self, env: int) -> dict[str, NDArray[np.floating]]:
        """Positions of each team since its episode began, [n, V, 3] m, oldest first."""
        past, later = [], int(self.task.steps[env])
        for steps, teams in reversed(self._trails):
            if (then := int(steps[env])) > later:
                break
            later = then
            past.append(teams)
        return {
            name: np.stack([teams[name][env].cpu().numpy() for teams in reversed(past)]).astype(np.float64)
            if past
            else np.zeros((0, fleet.count, 3))
            for name, fleet in self.task.world.teams.items()
        }


def tiled(frames: tuple[NDArray[np.uint8], ...]) -> NDArray[np.uint8]:
    """Arrange pictures of one size in a grid of about as many rows as columns."""
    high, wide, _ = frames[0].shape
    across = int(np.ceil(np.sqrt(len(frames))))
    down = -(-len(frames) // across)
    page = np.zeros((down * high, across * wide, 3), np.uint8)
    for k, frame in enumerate(frames):
        row, column = k // across * high, k % across * wide
        page[row : row + high, column : column + wide] = frame
    return page


class _Window:
    """A window of matplotlib."""

    def __init__(self) -> None:
        """Check that a window can be opened; `show` opens it."""
        import matplotlib
        from matplotlib import pyplot  # chooses a backend by what there is

        pyplot.get_fignums()
        backend = matplotlib.get_backend().lower()
        if backend in NO_WINDOWS:
            raise ValueError(
                f"render_mode = 'human': no window can be opened here (matplotlib uses {backend}: there is no display "
                "or no toolkit for windows); use 'rgb_array', with RecordVideo for films"
            )
        self._figure = self._image = None

    def show(self, picture: NDArray[np.uint8]) -> None:
        """Show a picture until the next one."""
        from matplotlib import pyplot

        if self._figure is None or self._image is None:
            high, wide, _ = picture.shape
            self._figure = pyplot.figure("taichi-sim", figsize=(wide / 100, high / 100), dpi=100)
            axes = self._figure.add_axes((0.0, 0.0, 1.0, 1.0))
            axes.set_axis_off()
            self._image = axes.imshow(picture)
        self._image.set_data(picture)
        self._figure.canvas.draw_idle()
        pyplot.pause(0.001)

    def close(self) -> None:
        """Close the window."""
        from matplotlib import pyplot

        if self._figure is not None:
            pyplot.close(self._figure)
            self._figure = self._image = None
