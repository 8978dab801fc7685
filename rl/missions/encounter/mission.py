"""Encounters: own ships keep their routes among ships that keep, obey or break the rules of the road (COLREGs).

An episode begins with an own ship on a straight route, and ships that it will meet if all go on
(situations.py). Ships are a scripted team (traffic.py). Own ships know them by AIS and radar (sensing.py); roles by
the rules are latched, and gaps measured between rectangles (pairs.py). An episode ends at a collision, or when its
time is up.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

import torch
from torch import Tensor

from rl.mission import Frame, Histories, Mission
from rl.missions.encounter.bodies import Body, Track, bodies_of, sizes_of
from rl.missions.encounter.config import AisConfig, BehavioursConfig, EncounterScenario, RadarConfig
from rl.missions.encounter.film import overlays_of
from rl.missions.encounter.judge import EncounterJudge
from rl.missions.encounter.pairs import Pairs
from rl.missions.encounter.situations import cases_of, drawn, from_table
from rl.missions.encounter.team import OwnShips
from rl.missions.encounter.traffic import Traffic
from rl.step import Due
from taichi_sim.config import AirConfig, ConfigError, SeaConfig
from taichi_sim.errors import refuse
from taichi_sim.fleet import Fleet
from taichi_sim.kernels.conventions import SURGE
from taichi_sim.kernels.rotation import level_states
from taichi_sim.state.snapshot import transfer
from taichi_sim.vehicle import Vehicle
from taichi_sim.visualisation.recording.episode import Episode, Scene

ROOM = 100.0  # m about the own ships, in recordings; assumed
KNOWN = 1e5  # m, range of the radar of models
TRACKED = [Body.NORTH, Body.EAST, Body.V_NORTH, Body.V_EAST, Body.LENGTH, Body.BEAM]
"""Columns of a body, in the order of a track's."""


class Encounter(Mission[EncounterScenario, OwnShips]):
    """Own ships among traffic; see the module.

    Attributes:
        bodies, before: [env, own ships and ships, Body], now and a decision ago. pairs: pairs.py.
        route: [env, own ship, 3] where each route begins (north, east, m) and its course (rad).
        case: int64 [env], number of the situation in its table.
    """

    Config = EncounterScenario
    Teams: ClassVar = {"own": OwnShips}
    Judge = EncounterJudge

    @classmethod
    def part(cls, config: EncounterScenario, team: str) -> str:
        """The part of a team, by `[encounter]`."""
        return "own" if team == config.encounter.own else team

    def make_teams(self, names: Sequence[str]) -> dict[str, OwnShips]:
        """Make bodies and pairs, then the own ships."""
        part, teams = self.config.encounter, self.world.teams
        self._own, self._ships = teams[part.own], teams[part.traffic]
        top = self._own.model.limits.speeds[2]
        slow = f"encounter.speed = {part.speed:g}: {part.own}'s vehicle can go {top:.3g} m/s"
        refuse(ConfigError, (part.speed > top, slow))
        self.bodies = self.remember(bodies_of(self._own, self._ships))
        self.before = self.remember(self.bodies.clone())
        self.pairs = self.remember(Pairs(self.config, self.bodies, self._own.count))
        self.route = self.remember(self.bodies.new_zeros((self.num_envs, self._own.count, 3)))
        self.case = self.remember(torch.zeros(self.num_envs, dtype=torch.int64, device=self.device))
        return super().make_teams(names)

    def prepare(self) -> None:
        """Show the ships who sails there."""
        script = self.world.scripts[self.config.encounter.traffic]
        if isinstance(script, Traffic):
            script.attach(self.bodies, self.noise.table)

    @property
    def ships(self) -> Fleet[Vehicle]:
        """The ships of traffic."""
        return self._ships

    def truth(self, due: Due) -> None:
        """Measure bodies and pairs, then the own ships."""
        fresh, begins = bodies_of(self._own, self._ships), due.begins.view(-1, 1, 1)
        goes_on = due.goes_on.view(-1, 1, 1)
        self.before.copy_(torch.where(goes_on, self.bodies, torch.where(begins, fresh, self.before)))
        self.bodies.copy_(torch.where(goes_on | begins, fresh, self.bodies))
        self.pairs.measure(self.bodies, self.before, due)
        super().truth(due)

    def begin(self, envs: Tensor, *, cases: Tensor | None = None) -> None:
        """Draw who meets whom in environments `envs`; `cases` int64 [n], of a table (default: random ones)."""
        config, part, n, own = self.config, self.config.encounter, len(envs), self._own.count
        table, script = cases_of(config), self.world.scripts[part.traffic]
        lengths = torch.cat((sizes_of(self._own)[..., 0], sizes_of(self._ships)[..., 0]), dim=1)[envs]
        tops = torch.full_like(lengths, self._own.model.limits.speeds[2])
        tops[:, own:] = script.tops[envs] if isinstance(script, Traffic) else self._ships.model.limits.speeds[2]
        if table:
            cases = self.draw(len(table), n) if cases is None else cases % len(table)
            self.case[envs] = cases
            begun = from_table(config, cases, tops, self.generator)
        else:
            flow = self.world.current.velocity[envs]
            begun = drawn(config, n, lengths, tops, own - 1, flow, self.generator)
        route = torch.zeros((n, own, 3), dtype=torch.float64)
        route[:, 0, 2] = begun.route
        route[:, 1:, :2], route[:, 1:, 2] = begun.place[:, : own - 1], begun.course[:, : own - 1]
        self.route[envs] = route.to(self.route)
        place, course, speed = (x[:, own - 1 :].to(self.bodies) for x in begun[1:])
        self.place(part.own, envs, route[..., :2].to(self.bodies), route[..., 2].to(self.bodies), part.speed)
        self.place(part.traffic, envs, place, course, speed)
        if isinstance(script, Traffic):
            script.start(envs, course, speed)

    def begin_each(self) -> None:
        """Begin environment e on sea e, in situation e of a table."""
        self.reset(seas=self._all % self.world.sea.num_seas, cases=self._all)

    # -- what others ask -------------------------------------------------------------------------------------------

    def imagined(self, team: OwnShips) -> "Encounter":
        """Make an `ImaginedEncounter`, with the same classes of teams."""
        kind = type("Imagined", (ImaginedEncounter,), {"Teams": self.Teams})
        config = imagined_scenario(self.config)
        return kind(config, self.num_envs, seed=self.seed, teams=(team.name,), source=self.source)

    @classmethod
    def piloted(cls, config: EncounterScenario, team: str) -> EncounterScenario:
        """The same as in plans; ships are those that are heard (`hear`)."""
        return imagined_scenario(config)

    def course(self, team: OwnShips) -> tuple[Tensor, Tensor]:
        """Where the first own ship's route begins, and its course."""
        return self.route[:, 0, :2], self.route[:, 0, 2]

    def hear(self, team: OwnShips, vessels: Tensor) -> None:
        """Track `vessels` alone, as many as there are ships, and the other own ships."""
        tracks, own = team.tracks, team.fleet.count
        tracks[..., Track.AGE] = -1.0
        each = torch.arange(own, device=self.device)
        tracks[:, :, :own, : Track.AGE] = self.bodies[:, None, :own, TRACKED]
        tracks[:, :, :own, Track.AGE] = torch.where(each == each.unsqueeze(1), -1.0, 0.0).to(tracks)
        heard = vessels[: tracks.shape[2] - own]
        tracks[:, :, own : own + len(heard), : Track.AGE + 1] = heard.to(tracks)
        team.conclude(self.due)

    # -- recordings ---------------------------------------------------------------------------------------------------

    def frame(self, env: int) -> Frame:
        """Tracks, safety domains, roles, the route (film.py)."""
        return Frame({}, overlays_of(self.teams[self.config.encounter.own], self.bodies, self.pairs, self.route, env))

    def scene(self, env: int) -> Scene:
        """The water about the first own ship."""
        part = self.config.encounter
        return Scene(overview=(part.own, ROOM + 0.5 * part.speed * part.notice))

    @classmethod
    def draw_figures(cls, out: Path, histories: Histories, episode: Episode | None, config: EncounterScenario) -> None:
        """See figures.py."""
        from rl.missions.encounter.figures import write_encounter_figures  # matplotlib takes a second

        write_encounter_figures(out, histories, episode, config)


def imagined_scenario(config: EncounterScenario) -> EncounterScenario:
    """The scenario of the model of the own ships: they are nominal, water is calm, wind and current are steady; ships
    keep course and speed, and are known exactly.
    """
    part, steady = config.encounter, {"std": 0.0, "turbulence": "none", "gust": None}
    current = config.sea.current and config.sea.current.model_copy(update={"std": 0.0})
    own = config.parts[part.own].model_copy(update={"vary": {}, "observe": None})
    radar = RadarConfig(
        range=KNOWN, period=config.decision_interval, range_noise=0, range_share=0, bearing_noise_deg=0, misses=0
    )
    keeps = BehavioursConfig(**dict.fromkeys(BehavioursConfig.model_fields, 0.0) | {"keeps": 1.0})
    return config.model_copy(
        update={
            "sea": SeaConfig(hs=0.0, tp=4.0, components=1, realisations=1, depth=config.sea.depth, current=current),
            "air": config.air.model_copy(update=steady) if config.air else AirConfig(),
            "vary": {}, "ais": AisConfig(carried=0.0), "radar": radar, part.own: own,
            "encounter": part.model_copy(update={"behaviours": keeps}),
        }
    )  # fmt: skip


class ImaginedEncounter(Encounter):
    """The model in which an honest planner (rl/planning/planner.py) tries plans of the own ships: see
    `imagined_scenario`. Ships are where the newest of the own ships' tracks has them; those without are not there.
    """

    def believe(self, team: OwnShips) -> None:
        """Write mean wind and current, the own ships as they are, and ships as they are tracked."""
        mine, world, everywhere = self.teams[team.name], team.mission.world, self._all
        self.steps.copy_(team.mission.steps)
        self.route.copy_(team.mission.route)
        self.world.wind.set_mean(everywhere, world.wind.mean)
        self.world.current.set_mean(everywhere, world.current.steady)
        for part in ("state", "aux", "surface"):
            getattr(mine.fleet, part).copy_(getattr(team.fleet, part))
        mine.fleet.update()
        self._suppose(team.tracks[:, :, team.fleet.count :], world.current.steady)
        self.measure_anew()
        for part in ("pairs", "tracking", "helm"):
            transfer(getattr(team, part), getattr(mine, part))
        mine.go_on_from(team)

    def _suppose(self, tracks: Tensor, current: Tensor) -> None:
        """Put ships where `tracks` [env, own ship, ship, Track] have them, in a `current` [env, 2 or 3]."""
        age = torch.where(tracks[..., Track.AGE] < 0, torch.inf, tracks[..., Track.AGE])
        newest = age.argmin(1, keepdim=True).unsqueeze(-1).expand(-1, 1, -1, tracks.shape[-1])
        track, known = tracks.gather(1, newest)[:, 0], age.amin(1).isfinite().unsqueeze(-1)
        place = torch.where(known, track[..., : Track.V_NORTH], 2 * KNOWN)
        v = torch.where(known, track[..., Track.V_NORTH : Track.LENGTH], 0.0)
        through = v - torch.where(known, current[:, None, :2], 0.0)
        course, speed = torch.atan2(through[..., 1], through[..., 0]), through.norm(dim=-1)
        ships = self.ships
        if "length" in ships.model.varying:
            ships.set_numbers({"length": torch.where(known[..., 0], track[..., Track.LENGTH], ships.model.size[0])})
        state = level_states(place, course, 0.0)
        c, s = course.cos(), course.sin()
        state[..., SURGE], state[..., SURGE + 1] = c * v[..., 0] + s * v[..., 1], c * v[..., 1] - s * v[..., 0]
        self.world.place(ships.name, self._all, state)
        script = self.world.scripts[ships.name]
        if isinstance(script, Traffic):
            script.start(self._all, course, speed)


MISSION = Encounter
