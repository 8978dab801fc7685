"""Landing: multirotors come in over boats in a seaway and land on their decks.

Aircraft i lands on boat i. An episode begins with the boats under way, or still, on courses that they hold, and each
aircraft in hover 20 to 60 m from its deck, anywhere around. An aircraft knows itself by its instruments, the deck by a
camera that sees a marker on it from near and by what the boat tells by radio (boats.py), late and at times lost
(known_deck.py). It has landed when all its soles have been on the deck for some seconds, and it came down softly
(`[landing]`).
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

import torch
from torch import Tensor

from rl.mission import Frame, Histories, Mission
from rl.missions.landing.aircraft import Aircraft, SensingAircraft
from rl.missions.landing.boats import Boats, Helm, Message
from rl.missions.landing.config import LandingConfig, LandingScenario
from rl.missions.landing.film import overlays_of
from rl.missions.landing.judge import LandingJudge
from rl.missions.landing.planning_model import ImaginedLanding, imagined_scenario
from rl.perception.radio import Radio
from rl.step import Due
from taichi_sim.config import ConfigError
from taichi_sim.fleet import Fleet
from taichi_sim.kernels import runtime
from taichi_sim.kernels.conventions import DOWN, EAST, NORTH, QUATERNION, STATE_SIZE, SURGE
from taichi_sim.kernels.rotation import torch_quaternion_from_euler
from taichi_sim.visualisation.recording.episode import Episode, Scene

TRIES = 50  # draws of places, until all aircraft are apart
SPACED = 4.0  # least distance between two aircraft as an episode begins, over their collision radius; assumed
SEEN_FROM_AFAR = 40.0  # m about the first boat, in recordings


def afloat(fleet: Fleet, config: LandingScenario, n: int, generator: torch.Generator) -> tuple[Tensor, Tensor, Tensor]:
    """Draw states [n, boat, 13], courses (rad) and speeds (m/s) of the boats of `n` environments.

    The boats of an environment are abreast, on one course, each at a speed of its own.
    """
    like, count = fleet.state, fleet.count
    draw = torch.rand((n, count + 1), generator=generator).to(like)
    course = (2 * math.pi * draw[:, :1]).expand(-1, count)
    low, high = config.course.speed
    speed = low + (high - low) * draw[:, 1:]
    state = like.new_zeros((n, count, STATE_SIZE))
    rank = (torch.arange(count, device=like.device) - (count - 1) / 2) * config.landing.apart
    state[..., NORTH], state[..., EAST] = -rank * course.sin(), rank * course.cos()
    state[..., QUATERNION] = torch_quaternion_from_euler(0 * course, 0 * course, course)
    state[..., SURGE] = speed
    return state, course, speed


def aloft(team: Aircraft, over: Tensor, config: LandingConfig, generator: torch.Generator) -> Tensor:
    """Draw states [n, aircraft, 13] of aircraft that hover around `over` [n, aircraft, 2] (m), with any heading."""
    like, n = team.fleet.state, len(over)
    state = like.new_zeros((*over.shape[:2], STATE_SIZE))
    rows = torch.arange(n, device=like.device)
    for _ in range(TRIES):
        draw = torch.rand((len(rows), over.shape[1], 4), generator=generator).to(like)
        side, heading, apart, up = draw.unbind(-1)
        (near, far), (low, high) = config.distance, config.height
        bearing, heading, distance = 2 * math.pi * side, 2 * math.pi * heading, near + (far - near) * apart
        away = torch.stack((bearing.cos(), bearing.sin()), dim=-1)
        state[rows, :, :2] = over[rows] + distance.unsqueeze(-1) * away
        state[rows, :, DOWN] = -(low + (high - low) * up)
        state[rows, :, QUATERNION] = torch_quaternion_from_euler(0 * heading, 0 * heading, heading)
        apart = torch.cdist(state[..., :3], state[..., :3])
        apart.diagonal(dim1=1, dim2=2).fill_(math.inf)
        rows = (apart.flatten(1).amin(1) < SPACED * team.fleet.model.collision_radius).nonzero().flatten()
        if not len(rows):
            return state
    raise ConfigError(
        f"landing.distance = {list(config.distance)}, landing.height = {list(config.height)}, landing.apart = "
        f"{config.apart:g}: two aircraft would begin in one place, {float(apart.amin()):.3g} m from each other; "
        f"allowed are {SPACED * team.fleet.model.collision_radius:g} m or more"
    )


class Landing(Mission[LandingScenario, SensingAircraft]):
    """Boats with decks and aircraft that land on them; see the module.

    Attributes:
        boats: the boats (boats.py). aircraft: the team of aircraft, or None. hs: [env] significant wave height, m.
        radio: between boats and aircraft, boats first.
    """

    Config = LandingScenario
    Teams: ClassVar = {"aircraft": SensingAircraft}
    Judge = LandingJudge

    @classmethod
    def part(cls, config: LandingScenario, team: str) -> str:
        """The part of a team, by `[landing]`."""
        return "aircraft" if team == config.landing.aircraft else team

    def __init__(
        self, config: LandingScenario, num_envs: int, *, seed: int, teams: Sequence[str] | None = None,
        source: Path | None = None,
    ):  # fmt: skip
        """Build the mission (see `Mission`), with boats even if they are not among the `teams`."""
        there = None if teams is None else [team for team in config.teams if team in (*teams, config.landing.boats)]
        super().__init__(config, num_envs, seed=seed, teams=there, source=source)

    def make_teams(self, names: Sequence[str]) -> dict[str, SensingAircraft]:
        """Make the boats, which a script steers, and the aircraft."""
        run, parts, fleets = runtime.current(), self.config.landing, self.world.teams
        for name in names:
            if name not in (parts.boats, parts.aircraft):
                raise ConfigError(
                    f"{name}: landing.boats = {parts.boats!r} and landing.aircraft = {parts.aircraft!r} name the teams "
                    "of the mission; give any other a script"
                )
        self._hs = torch.as_tensor(self.world.sea.components.hs).to(run.device, run.torch_dtype)
        self.hs = self.remember(torch.zeros(self.num_envs, device=run.device, dtype=run.torch_dtype))
        self.boats = self.remember(Boats(fleets[parts.boats], self.steps, self.config))
        craft = self.boats.fleet.count + (fleets[parts.aircraft].count if parts.aircraft in names else 0)
        self._place = self.scratch(self.boats.fleet.state.new_zeros((self.num_envs, craft, 3)))
        self.radio = self.remember(
            Radio(self.config.radio, self._place, self.config.decision_interval, width=Message.SIZE)
        )
        self.world.scripts[parts.boats], self.aircraft = Helm(self.boats), None
        if parts.aircraft not in names:
            return {}
        self.aircraft = self.kinds(self.config)[parts.aircraft](self, parts.aircraft, self.boats, self.radio)
        return {parts.aircraft: self.aircraft}

    # -- one step --------------------------------------------------------------------------------------------------

    def truth(self, due: Due) -> None:
        """Measure the decks, then the aircraft."""
        self.boats.follow()
        super().truth(due)

    def perceive(self, due: Due) -> None:
        """Boats read their instruments; aircraft look at their decks, too."""
        self.boats.perceive(due)
        super().perceive(due)

    def exchange(self, due: Due) -> None:
        """All have one radio."""
        count, place, said = self.boats.fleet.count, self._place, self.radio.said
        place[:, :count], said[:, :count] = self.boats.fleet.position_n, self.boats.message()
        if self.aircraft is not None:
            place[:, count:] = self.aircraft.fleet.position_n
            said[:, count:, :3], said[:, count:, 3:6] = self.aircraft.own.position_n, self.aircraft.own.velocity_n
        self.radio.talk(due)
        super().exchange(due)

    # -- episodes --------------------------------------------------------------------------------------------------

    def begin(self, envs: Tensor) -> None:
        """Place boats and aircraft in environments `envs` [n]."""
        self.hs[envs] = self._hs[self.world.env_sea[envs].long()]
        state, course, speed = afloat(self.boats.fleet, self.config, len(envs), self.generator)
        self.boats.begin(envs, course, speed)
        self.world.place(self.boats.fleet.name, envs, state)
        if self.aircraft is not None:
            x, y = self.boats.centre[:2]
            c, s = course.cos(), course.sin()
            decks = state[..., :2] + torch.stack((c * x - s * y, s * x + c * y), dim=-1)
            state = aloft(self.aircraft, decks, self.config.landing, self.generator)
            self.world.place(self.aircraft.name, envs, state)
            self.aircraft.begin(envs)

    # -- what others ask -------------------------------------------------------------------------------------------

    def imagined(self, team: SensingAircraft) -> ImaginedLanding | None:
        """Make an `ImaginedLanding`."""
        config, parts = imagined_scenario(self.config, self.world.sea.table.shape[2]), self.config.landing
        teams = (parts.boats, parts.aircraft)
        made = ImaginedLanding(config, self.num_envs, seed=self.seed, teams=teams, source=self.source)
        made.aircraft.fleet.model = team.fleet.model  # whose kernels are compiled
        return made

    @classmethod
    def piloted(cls, config: LandingScenario, team: str) -> LandingScenario | None:
        """Exact instruments, markers that are always found in sight, prompt messages."""
        if team != config.landing.aircraft:
            return None
        calm = imagined_scenario(config, config.sea.components)
        section = calm.parts[team]
        sure = section.marker.model_copy(update={"loss": 0.0, "spray": 0.0})
        return calm.model_copy(update={"vary": {}, team: section.model_copy(update={"marker": sure})})

    def followed(self, team: SensingAircraft) -> dict[str, float]:
        """The boats, from as far as episodes begin."""
        return {self.boats.fleet.name: self.config.landing.distance[1]}

    def frame(self, env: int) -> Frame:
        """Return the frame: the aircraft's distances from their deck's middle, and overlays (heights, the estimated
        deck, sight lines).
        """
        flying = {} if self.aircraft is None else {self.aircraft.name: {"error_m": self.aircraft.distance[env]}}
        return Frame(flying, overlays_of(self.boats, self.aircraft, env))

    def scene(self, env: int) -> Scene:
        """The surroundings of the first boat."""
        return Scene(overview=(self.boats.fleet.name, SEEN_FROM_AFAR))

    @classmethod
    def draw_figures(cls, out: Path, histories: Histories, episode: Episode | None, config: LandingScenario) -> None:
        """See figures.py."""
        from rl.missions.landing.figures import write_landing_figures  # matplotlib takes a second

        write_landing_figures(out, histories, episode, config)


MISSION = Landing
