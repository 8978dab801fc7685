"""The own ships: each follows a route by line of sight, and gives way by offsets of course and speed.

A policy's actions are those of SB-MPC (avoidance.py): an offset of the course, up to 90 degrees to either side, and a
factor of the planned speed; or, with `[TEAM.correction]`, corrections of those that SB-MPC chooses, where the candidate
nearest to the result is in no greater danger, as SB-MPC foresees it. The course that the nose is to take is

    chi = route + x - (1 - min(|x| / 15 deg, 1)) atan(across / lookahead) - crab,

with x the offset, which suspends the line of sight to the route from 15 degrees on, and crab the averaged angle between
course over ground and heading: what wind, waves and current make of it.
"""

import math
from typing import Protocol

import torch
from torch import Tensor

from rl.guidance.helm import Helm
from rl.guidance.targets_and_errors import wrap
from rl.missions.encounter.avoidance import TURN, Plans, SbmpcGains, nearest
from rl.missions.encounter.bodies import Body, Track
from rl.missions.encounter.config import EncounterConfig, EncounterScenario, EncounterTeam
from rl.missions.encounter.pairs import Pair, Pairs
from rl.missions.encounter.rewards import TERMS
from rl.missions.encounter.sensing import Tracking
from rl.step import Due, Endings
from rl.team import Controller, Host, Team
from taichi_sim.config.io import validate
from taichi_sim.kernels.conventions import HORIZONTAL, YAW_RATE
from taichi_sim.kernels.rotation import torch_heading
from taichi_sim.state.memory import Remembers
from taichi_sim.vehicle import Vehicle

MOST_OFFSET = math.pi / 2
CORRECTIONS = "course (correction)", "speed (correction)"
CRAB_TIME = 10.0  # s over which the crab angle is averaged; assumed
UNDERWAY = 0.2  # of the planned speed: a slower vessel has no crab angle
NEAREST = 3  # tracks that are observed one by one
PER_TRACK = 9


class Sea(Host, Protocol):
    """What the own ships ask of the mission."""

    bodies: Tensor
    before: Tensor
    pairs: Pairs
    route: Tensor

    @property
    def config(self) -> EncounterScenario:
        """The scenario."""
        ...


class OwnShips(Team[Sea, EncounterTeam]):
    """The own ships; see the module. Every tensor is [env, own ship, ...].

    Attributes:
        part: `[encounter]`. pairs: the truth (pairs.py). tracking: what they know of others (sensing.py).
        offsets, before: offset of course (rad) and factor of speed in force, and a decision ago. crab: rad.
        ordered: the nose's course and the speed, as a velocity (NED, m/s).
    """

    terms = TERMS
    logged = ("least_gap_m", "collided", "across_m")
    meanings = {
        "route": "across over the lookahead, squashed; speed along and across the route over the planned one",
        "helm": "course to the next point less heading: cosine and sine; yaw rate times 10 s; offsets in force, and "
        "those of SB-MPC",
        "dangers": "of each candidate offset (SB-MPC's 39), logarithm of 1 + its danger, over 5",
        "gaps": "of each candidate, its least gap to a track, squashed by `clear`",
        "tracks": "of the 3 riskiest tracks: range, bearing, velocity ahead and aside, miss and time to it, age, size",
    }

    def __init__(self, mission: Sea, name: str):
        """Make team `name`."""
        super().__init__(mission, name)
        config, state = mission.config, self.fleet.state
        self.part: EncounterConfig = config.encounter
        self.helm = self.remember(Helm(self.fleet, mission.steps, f"{name}.vehicle"))
        self.pairs = mission.pairs
        self.tracking = self.remember(Tracking(config, mission.bodies, self.fleet.count))
        self.offsets = self.remember(state.new_tensor([0.0, 1.0]).expand(*state.shape[:2], 2).clone())
        self.before = self.remember(self.offsets.clone())
        self.crab = self.remember(state.new_zeros(state.shape[:2]))
        self.ordered = self.remember(state.new_zeros((*state.shape[:2], 2)))
        self._weighed: tuple[Tensor, Tensor] | None = self.scratch(None)
        self.plans = Plans(validate(SbmpcGains, {**self.section.control}, f"{name}.control"))

    # -- guidance --------------------------------------------------------------------------------------------------

    @property
    def across(self) -> Tensor:
        """Distance from the route, to starboard, m."""
        return self._on_route(self.fleet.position_n)[1]

    @property
    def along(self) -> Tensor:
        """Speed made good along the route, m/s."""
        return self._on_route(self.fleet.velocity_n, moved=False)[0]

    def _on_route(self, vector: Tensor, moved: bool = True) -> tuple[Tensor, Tensor]:
        """Parts of a vector along the route and to starboard of it; of places from where the route begins."""
        route = self.mission.route
        flat = vector[..., HORIZONTAL] - route[..., :2] if moved else vector[..., HORIZONTAL]
        c, s = route[..., 2].cos(), route[..., 2].sin()
        return c * flat[..., 0] + s * flat[..., 1], c * flat[..., 1] - s * flat[..., 0]

    @property
    def course(self) -> Tensor:
        """Course over ground (rad) that leads back to the route."""
        return self.mission.route[..., 2] - torch.atan(self.across / self.part.lookahead)

    @property
    def courses(self) -> Tensor:
        """Course of the route, and the one without an offset, rad, [env, own ship, 2]."""
        return torch.stack((self.mission.route[..., 2], self.course), dim=-1)

    @property
    def here(self) -> Tensor:
        """The own ships as bodies [env, own ship, Body]."""
        return self.mission.bodies[:, : self.fleet.count]

    @property
    def tracks(self) -> Tensor:
        """What they know of others [env, own ship, body, Track]."""
        return self.tracking.tracks

    def sail(self, offsets: Tensor) -> Tensor:
        """Vehicle actions under offsets [env, own ship, 2] of course (rad) and speed (factor), which are in force
        then.
        """
        self.before, self.offsets = self.offsets, offsets
        route, back = self.courses.unbind(-1)
        share = (1.0 - offsets[..., 0].abs() / TURN).clamp(min=0.0)
        course, speed = route + offsets[..., 0] + share * (back - route) - self.crab, self.part.speed * offsets[..., 1]
        self.ordered = speed.unsqueeze(-1) * torch.stack((course.cos(), course.sin()), dim=-1)
        return self.helm(wrap(course), speed)

    # -- phases ----------------------------------------------------------------------------------------------------

    @property
    def action_names(self) -> tuple[str, ...]:
        """Offset of course, over 90 degrees, to starboard positive, and of speed, where 0 and above is the planned
        one; or corrections, over the most.
        """
        return ("course", "speed") if self.section.correction is None else CORRECTIONS

    @property
    def uses_controller(self) -> bool:
        """Whether the controller has been made, or is corrected."""
        return super().uses_controller or self.section.correction is not None

    def commanded(self, action: Tensor) -> Tensor:
        """See `sail`."""
        correction = self.section.correction
        if correction is None:
            course, speed = action.unbind(-1)
            return self.sail(torch.stack((MOST_OFFSET * course, (1.0 + speed).clamp(0.0, 1.0)), dim=-1))
        most = action.new_tensor([math.radians(correction.course_deg), correction.speed])
        wanted, (fan, best) = self.corrected(most * action), self.weighed
        danger = (fan[..., 0].gather(-1, nearest(x).unsqueeze(-1)) for x in (wanted, best))
        return self.sail(torch.where(next(danger) <= next(danger), wanted, best))

    def corrected(self, correction: Tensor) -> Tensor:
        """Offsets that SB-MPC chooses, plus corrections [env, own ship, 2] (rad, share of the planned speed)."""
        course, speed = (self.weighed[1] + correction).unbind(-1)
        return torch.stack((course.clamp(-MOST_OFFSET, MOST_OFFSET), speed.clamp(0.0, 1.0)), dim=-1)

    @property
    def weighed(self) -> tuple[Tensor, Tensor]:
        """The candidates, and the offsets that SB-MPC chooses (`Plans`)."""
        if self._weighed is None:
            self._weighed = self.plans(self)
        return self._weighed

    def conclude(self, due: Due) -> None:
        """Drop what has been weighed, for they know more."""
        self._weighed = None

    def restored(self) -> None:
        """Likewise, after a snapshot was restored."""
        self._weighed = None

    def go_on_from(self, team: "OwnShips") -> None:
        """Go on as the own ships of another mission, of which all else has been taken over."""
        self.offsets, self.before, self.crab = team.offsets.clone(), team.before.clone(), team.crab.clone()
        self._weighed = None

    def truth(self, due: Due) -> None:
        """Begin without offsets; average the crab angle."""
        begins = due.begins.view(-1, 1, 1)
        calm = self.offsets.new_tensor([0.0, 1.0])
        self.offsets = torch.where(begins, calm, self.offsets)
        self.before = torch.where(begins, calm, self.before)
        v, dt = self.fleet.velocity_n[..., HORIZONTAL], self.mission.config.decision_interval
        crab = wrap(torch.atan2(v[..., 1], v[..., 0]) - torch_heading(self.fleet.quaternion_nb))
        share = dt / (CRAB_TIME + dt) * (v.norm(dim=-1) > UNDERWAY * self.part.speed)
        crab = self.crab + share * wrap(crab - self.crab)
        self.crab = torch.where(due.begins.unsqueeze(1), 0.0, torch.where(due.goes_on.unsqueeze(1), crab, self.crab))

    def perceive(self, due: Due) -> None:
        """Sense others by AIS and radar."""
        self.tracking.sense(self.mission.bodies, self.mission.before, due)

    def margins(self) -> dict[str, Tensor]:
        """To contact with any hull; to the edge of the corridor about the route, m."""
        return {"collided": self.pairs.gap - 1e-3, "lost": self.part.corridor - self.across.abs()}

    def importance(self, ending: str) -> Tensor:
        """Of a collision: the greatest risk (pairs.py), less the gap that is left over `clear`."""
        if ending != "collided":
            return super().importance(ending)
        return self.pairs.of(Pair.RISK).amax(-1) - self.pairs.gap / self.part.clear

    def log(self, ended: Endings) -> dict[str, Tensor]:
        """Least gap, collisions in this step, distance from the route."""
        return {
            "least_gap_m": self.pairs.gap.clamp(max=self.part.corridor).mean(),
            "collided": ended["collided"].float().mean(),
            "across_m": self.across.abs().mean(),
        }

    def info(self) -> dict[str, Tensor]:
        """gap: m, to the nearest hull."""
        return {"gap": self.pairs.gap}

    # -- control ---------------------------------------------------------------------------------------------------

    def make_controller(self) -> Controller:
        """SB-MPC."""
        return Sbmpc(self.fleet.model, self.plans.gains)

    @property
    def plan_names(self) -> tuple[str, ...]:
        """Corrections of the offset of course (rad) and of the factor of speed."""
        return CORRECTIONS

    def planned(self, correction: Tensor, known: object = None) -> Tensor:
        """See `corrected`; a plan weighs dangers itself."""
        return self.sail(self.corrected(correction))

    # -- observations ----------------------------------------------------------------------------------------------

    def observe(self) -> dict[str, Tensor]:
        """See `meanings`."""
        part, fleet = self.part, self.fleet
        along, aside = self._on_route(fleet.velocity_n, moved=False)
        off = self.across / part.lookahead
        turn = wrap(self.course - torch_heading(fleet.quaternion_nb))
        fan, best = self.weighed
        gaps = fan[..., 1].clamp(min=0.0)
        return {
            "route": torch.stack((off / (1 + off.abs()), along / part.speed, aside / part.speed), dim=-1),
            "helm": torch.cat((turn.cos().unsqueeze(-1), turn.sin().unsqueeze(-1), 10 * fleet.state[..., YAW_RATE:],
                               self.offsets, best), dim=-1),
            "dangers": torch.log1p(fan[..., 0]) / 5.0,
            "gaps": gaps / (gaps + part.clear),
            "tracks": self._tracks(),
        }  # fmt: skip

    def _tracks(self) -> Tensor:
        """The riskiest tracks [env, own ship, NEAREST * PER_TRACK]; zeros where there are less."""
        part, here, tracks = self.part, self.here, self.tracking.tracks
        to = tracks[..., : Track.V_NORTH] - here[..., None, : Body.V_NORTH]
        its = tracks[..., Track.V_NORTH : Track.LENGTH]
        w = here[..., None, Body.V_NORTH : Body.COS] - its
        far = to.norm(dim=-1).clamp(min=1.0)
        time = (to * w).sum(-1) / w.square().sum(-1).clamp(min=1e-3)
        ahead = time.clamp(0.0, 2 * part.notice)
        miss = (to - ahead.unsqueeze(-1) * w).norm(dim=-1) - 0.5 * tracks[..., Track.LENGTH]
        risk = 1.0 / (1.0 + miss.clamp(min=0.0) / part.clear) / (1.0 + ahead / part.notice)
        risk = torch.where(self.tracking.known, risk * (0.3 + 0.7 * (time > 0)), -1.0)
        most, which = risk.topk(min(NEAREST, risk.shape[-1]), dim=-1)
        c, s = (x.unsqueeze(-1) for x in (here[..., Body.COS], here[..., Body.SIN]))
        ahead_of, beside = (c * to[..., 0] + s * to[..., 1]) / far, (c * to[..., 1] - s * to[..., 0]) / far
        u, v = c * its[..., 0] + s * its[..., 1], c * its[..., 1] - s * its[..., 0]
        reach = part.speed * part.notice
        length, soon = tracks[..., Track.LENGTH], time.clamp(-part.notice, 3 * part.notice) / part.notice
        close = part.clear / (part.clear + miss.clamp(min=0.0))
        rows = torch.stack(
            (reach / (reach + far), ahead_of, beside, u / part.speed, v / part.speed, close, soon,
             tracks[..., Track.AGE] / 60.0, length / (length + part.clear)), dim=-1,
        )  # fmt: skip
        found = rows.gather(2, which.unsqueeze(-1).expand(*which.shape, PER_TRACK))
        found = torch.where((most > 0).unsqueeze(-1), found, 0.0).flatten(2)
        missing = NEAREST * PER_TRACK - found.shape[-1]
        return torch.nn.functional.pad(found, (0, missing)) if missing else found

    def truth_now(self) -> Tensor | None:
        """Privileged: true gap, risk and role of the nearest, and what varies."""
        gap = self.pairs.gap.unsqueeze(-1)
        near = gap.clamp(min=0.0)
        parts = [near / (near + self.part.clear), self.pairs.of(Pair.RISK).amax(-1, keepdim=True)]
        if self.mission.config.varies:
            parts.append(self.mission.world.truth[self.name])
        return torch.cat(parts, dim=-1)


class Sbmpc(Remembers):
    """SB-MPC as a classical controller of own ships."""

    Gains = SbmpcGains

    def __init__(self, model: Vehicle, gains: SbmpcGains | None = None):
        """Decide by these gains, whatever the vehicle."""
        self.plans = Plans(gains or SbmpcGains())

    def offsets(self, team: OwnShips) -> Tensor:
        """The best offsets [env, own ship, 2]."""
        return self.plans(team)[1]

    def __call__(self, team: OwnShips) -> Tensor:
        """Vehicle actions."""
        return team.sail(self.offsets(team))
