"""The aircraft of the mission: their position over their decks, their knowledge of it, and their landings."""

import math
from typing import Protocol

import torch
from torch import Tensor

from rl.guidance.observations import squashed
from rl.missions.landing.config import LandingScenario, LandingTeam
from rl.missions.landing.decks import DeckMotion, Decks
from rl.missions.landing.known_deck import LAGS, KnownDeck
from rl.missions.landing.level_frame import into_level
from rl.missions.landing.marker import Look, Marker
from rl.missions.landing.pilots import Pilot, corrected
from rl.missions.landing.rewards import AIRCRAFT_TERMS
from rl.perception.instruments import Readings
from rl.perception.radio import Radio
from rl.step import COLLIDED, Due, Endings
from rl.team import Host, Team
from taichi_sim.config import ConfigError
from taichi_sim.kernels.conventions import BELOW, DOWN
from taichi_sim.models.uav.multirotor.multirotor_6dof import Multirotor6DOF

NEAR = 1.0  # m, where what is observed near the deck is of order one
FAR, FAST, SLOW = 10.0, 3.0, 1.0  # m, m/s, m/s, where what is observed is half way to 1
WENT_LOW, WENT_UP = 1.0, 2.5  # m above the deck: who was lower and is then higher has aborted; assumed
SITS = math.cos(math.radians(8.0))  # cosine of the tilt to the deck up to which it lets go; assumed
FINEST = 0.15  # share of its authority that a policy has at the deck; assumed
RISE = 2.0  # m above the deck and beside its middle, up to where an aircraft that leaves goes straight up; assumed
SQUARE = 1.5  # 1/s, at which it turns its nose square to the deck, for legs to have the most room; assumed
STILL = 0.2  # m/s to its deck, below which an aircraft that stands there rests; assumed
RISING = 1.0  # m/s, of one that must leave its deck; assumed


class LandingHost(Host, Protocol):
    """What the mission, and the model of it (planning_model.py), share with their aircraft; `hs` is [env], m, live."""

    hs: Tensor

    @property
    def config(self) -> LandingScenario:
        """The scenario."""
        ...


class Aircraft(Team[LandingHost, LandingTeam]):
    """The team of aircraft, measured after each step; every tensor is [env, aircraft, ...].

    Aircraft i lands on boat i. How they know their decks, a derived class says.

    Attributes:
        model: of the vehicles. decks: the boats, as they are.
        own: what they measure of themselves. known_deck: what they know of their decks.
        offset: [.., 3] from the deck's middle, b of the boat, m. height: of the soles above the deck, m.
        distance: from the deck's middle, level distance and height together, m. to_go, before: time to the deck's
            middle at the greatest speed and rate of descent, now and a decision ago, s.
        tilt: to the deck, rad. touched, touching: has touched, for the first time in this step. touch_error (m, level),
            touch_tilt (rad): then. touch_speed: greatest normal speed of a sole that has come down so far, m/s.
        settled, settling: all soles have been on the deck, for the first time in this step.
        stood: s that all soles have been on the deck. drifted: m on the deck since. aborts: how often it has gone up.
        time: s until the first touch.
    """

    meanings = {
        "to": f"to the deck's middle, m, squashed by {FAR:g}; vectors are level: along the deck, to starboard, down",
        "to_near": f"level part of the same over {NEAR:g} m, clipped to 1",
        "height": "of the soles above the deck, m, squashed by 2",
        "height_near": f"the same over {NEAR:g} m, clipped to -0.5 and 1",
        "relative_velocity": f"of the deck past the aircraft, m/s, squashed by {SLOW:g}",
        "velocity": f"over ground, m/s, squashed by {FAST:g}",
        "deck_velocity": f"m/s, squashed by {SLOW:g}",
        "deck_acceleration": "m/s^2, squashed by 1",
        "deck_past": f"its vertical velocity {', '.join(map(str, LAGS))} decisions ago, m/s, squashed by {SLOW:g}",
        "deck_tilt": "roll and pitch of the deck, rad, times 5",
        "deck_rates": "the deck's rates, rad/s, times 2",
        "tilt": "level part of the aircraft's unit vector up, times 2",
        "rates": "roll and pitch, rad/s",
        "ages": "since the marker was seen, since the boat was heard, s, squashed by 1",
        "time_left": "share of the episode that is left",
        "standing": "1 if it has touched; 1 if all soles are on the deck",
        "previous_action": "the last actions, -1 to 1",
        "reference": f"change of velocity that the pilot asks for, m/s, squashed by {SLOW:g}",
    }
    terms = AIRCRAFT_TERMS
    logged = ("landed", "failed", "touch_error_m", "touch_speed")

    def __init__(self, mission: LandingHost, name: str, decks: Decks):
        """Prepare team `name`, which lands on `decks`."""
        super().__init__(mission, name)
        config, state, model = mission.config, self.fleet.state, self.fleet.model
        told = f"{name}.vehicle = {self.section.vehicle!r}"
        if not isinstance(model, Multirotor6DOF) or model.legs is None:
            raise ConfigError(f"{told}: to land it must be a multirotor_6dof with [legs]")
        self.model, self.decks, self.interval = model, decks, config.decision_interval
        self.own = self.remember(Readings(self.fleet, self.section.sensors, self.interval, config.first_number(name)))
        self.known_deck = self.remember(KnownDeck(state, self.interval, self.fleet.count))
        self.soles_below = float(model.soles(self.fleet)[..., BELOW].max())
        self._soles = state.new_tensor(model.legs.points)[:, :2]
        shape = state.shape[:2]
        self.offset, self._anchor = (self.remember(state.new_zeros((*shape, 3))) for _ in range(2))
        (
            self.height, self.distance, self.to_go, self.before, self.tilt, self.touch_error, self.touch_tilt,
            self.touch_speed, self.stood, self.drifted, self.aborts, self.time,
        ) = (self.remember(state.new_zeros(shape)) for _ in range(12))  # fmt: skip
        self.touched, self.touching, self.settled, self.settling, self._low = (
            self.remember(torch.zeros(shape, dtype=torch.bool, device=state.device)) for _ in range(5)
        )
        self._wanted: Tensor | None = self.scratch(None)

    @property
    def deck(self) -> DeckMotion:
        """The deck of each aircraft, the truth."""
        return self.decks.deck

    # -- flying ----------------------------------------------------------------------------------------------------

    def make_controller(self) -> Pilot:
        """The pilot of `[TEAM.pilot]`."""
        return Pilot(
            self.section.pilot, self.own, self.known_deck, self.model.gains, self.soles_below, self.steps, self.interval
        )

    @property
    def pilot(self) -> Pilot:
        """The classical pilot."""
        return self.controller  # pyright: ignore[reportReturnType] (made above)

    @property
    def uses_controller(self) -> bool:
        """Always: the pilot flies or is corrected."""
        return True

    def restored(self) -> None:
        """Drop the pilot's velocity after a snapshot was restored."""
        self._wanted = None

    @property
    def wanted(self) -> Tensor:
        """Velocity [env, aircraft, 3] (NED, m/s) that the pilot wants now."""
        if self._wanted is None:
            self._wanted = self.pilot.wanted()
        return self._wanted

    @property
    def action_names(self) -> tuple[str, ...]:
        """Names of the policy's outputs: corrections of the pilot's velocity, or the vehicle's own actions."""
        if self.section.correction is None:
            return super().action_names
        return self.plan_names

    @property
    def in_effect(self) -> Tensor:
        """Where the policy's actions have an effect, bool [env, aircraft]: the aircraft's thrust is on."""
        return ~self.lets_go

    @property
    def plannable(self) -> Tensor:
        """Where a plan could change what the aircraft does: as `in_effect`, bool [env, aircraft]."""
        return self.in_effect

    @property
    def touches(self) -> Tensor:
        """Whether each aircraft feels a sole on a deck, bool [env, aircraft]."""
        assert self.fleet.touch is not None
        return self.fleet.touch.on

    @property
    def lets_go(self) -> Tensor:
        """Whether each aircraft cuts its thrust, bool [env, aircraft].

        It does so when a sole is on the deck and, by its own estimate, all soles are over the deck and the aircraft is
        upright.
        """
        known, deck = self.known_deck, self.decks.fleet.model.deck
        assert deck is not None
        to = into_level(known.to, known.heading)[..., :2].unsqueeze(-2)
        c, s = (part.unsqueeze(-1) for part in self._turned)
        x, y = self._soles.unbind(-1)
        soles = torch.stack((c * x - s * y, s * x + c * y), dim=-1)  # [env, aircraft, leg, 2]
        over = ((soles - to).abs() <= to.new_tensor(deck.half)).all(-1).all(-1)
        upright = (self.own.R_nb[..., BELOW] * known.down).sum(-1) > SITS
        return self.touches & over & upright

    @property
    def _turned(self) -> tuple[Tensor, Tensor]:
        """Cosine and sine [env, aircraft] of the aircraft's heading relative to that of its deck."""
        (c, s), (a, b) = self.known_deck.heading, self.own.heading
        return a * c + b * s, b * c - a * s

    @property
    def _off_square(self) -> Tensor:
        """Angle [env, aircraft] (rad) by which the aircraft must turn to be square to the edges of its deck."""
        c, s = self._turned
        c, s = c * c - s * s, 2 * s * c  # of twice the angle
        return -0.25 * torch.atan2(2 * s * c, c * c - s * s)

    @property
    def standing(self) -> Tensor:
        """Whether each aircraft feels all soles on a deck, bool [env, aircraft]."""
        assert self.fleet.touch is not None
        return self.fleet.touch.all_down

    def commanded(self, action: Tensor) -> Tensor:
        """Vehicle actions [env, aircraft, a] for the policy's actions or corrections."""
        c = self.section.correction
        if c is None:
            return action
        known = self.known_deck
        away = torch.hypot(known.to[..., :2].norm(dim=-1), self.known_height)
        share = (away / c.reach).clamp(FINEST, 1.0).unsqueeze(-1)
        wanted, far = self.wanted.clone(), away > c.reach
        wanted[..., DOWN] = torch.where(far, wanted[..., DOWN].clamp(min=0.0), wanted[..., DOWN])
        velocity = corrected(wanted, share * action, known.heading, c.level, c.vertical)
        return self.flown(self.pilot.limited(velocity, self.pilot.config.approach + c.level))

    @property
    def plan_names(self) -> tuple[str, ...]:
        """Names of the corrections in a plan: of the pilot's velocity command, m/s, in the deck's level frame."""
        return ("ahead (correction)", "to starboard (correction)", "down (correction)")

    def planned(self, correction: Tensor, known: object = None) -> Tensor:
        """Actions for the pilot's command plus a `correction` in m/s at any height; see Team.planned.

        The pilot always acts on what is known. If `known` is given, the plan also keeps the pilot's limits.
        """
        velocity = corrected(self.wanted, correction, self.known_deck.heading, 1.0, 1.0)
        if known is not None:
            velocity = self.pilot.limited(velocity, self.pilot.config.approach)
        return self.flown(velocity)

    def flown(self, velocity: Tensor) -> Tensor:
        """Actions [env, aircraft, a] that fly a velocity [env, aircraft, 3] (NED, m/s), aligned with the deck.

        Once a sole is on the deck and all are over it, the actions command full descent, so that the rotors idle.
        """
        if self.model.actions != "velocity":
            raise ConfigError(
                f"{self.name}.vehicle = {self.section.vehicle!r} has control.actions = {self.model.actions!r}: to land "
                'it needs "velocity"'
            )
        known, demands, touches = self.known_deck, self.model.demands, self.lets_go
        level = into_level(torch.where(touches.unsqueeze(-1), known.velocity, velocity), self.own.heading)
        ahead, aside, down = level.unbind(-1)
        down = torch.where(down > 0, down / demands.descent, down / demands.climb)
        down = torch.where(touches, torch.ones_like(down), down)
        turn = torch.where(touches, 0.0, (known.rates[..., BELOW] + SQUARE * self._off_square) / demands.yaw_rate)
        action = torch.stack((ahead / demands.speed, aside / demands.speed, down, turn), dim=-1)
        idle = action.new_tensor((0.0, 0.0, 1.0, 0.0))
        return torch.where(self.standing.unsqueeze(-1), idle, action).clamp(-1.0, 1.0)

    def begin(self, envs: Tensor) -> None:
        """Begin episodes in environments `envs` [n]."""
        self.pilot.begin(envs)

    # -- measuring -------------------------------------------------------------------------------------------------

    def truth(self, due: Due) -> None:
        """Measure where each aircraft is over its deck, and how it touches."""
        self._wanted, deck = None, self.deck
        fresh, on = due.begins.unsqueeze(-1), due.goes_on.unsqueeze(-1)
        away = self.fleet.position_n - deck.place
        self.offset = (deck.R * away.unsqueeze(-1)).sum(-2)
        self.height = -self.offset[..., BELOW] - self.soles_below
        level = self.offset[..., :2].norm(dim=-1)
        above, demands = self.height.clamp(min=0.0), self.model.demands
        self.distance = torch.hypot(level, above)
        before, self.to_go = self.to_go, torch.hypot(level / demands.speed, above / demands.descent)
        self.before = torch.where(on, before, torch.where(fresh, self.to_go, self.before))
        upright = (self.fleet.R_nb[..., BELOW] * deck.down).sum(-1)
        self.tilt = upright.clamp(-1.0, 1.0).acos()
        self._touch(on, fresh, level)

    def _touch(self, on: Tensor, fresh: Tensor, level: Tensor) -> None:
        touch, dt = self.fleet.touch, self.interval
        assert touch is not None
        touched = self.touched & ~fresh
        self.touching = on & touch.on & ~touched
        self.touched = touched | self.touching
        self.touch_error = torch.where(self.touching, level, torch.where(fresh, 0.0, self.touch_error))
        self.touch_tilt = torch.where(self.touching, self.tilt, torch.where(fresh, 0.0, self.touch_tilt))
        speed = torch.maximum(self.touch_speed, touch.blow.squeeze(-1))
        self.touch_speed = torch.where(on, speed, torch.where(fresh, 0.0, self.touch_speed))
        standing = touch.all_down
        settled = self.settled & ~fresh
        self.settling = on & standing & ~settled
        self.settled = settled | self.settling
        new = standing & (self.stood == 0)
        self._anchor = torch.where(new.unsqueeze(-1), self.offset, self._anchor)
        stood = torch.where(standing, self.stood + dt, 0.0)
        self.stood = torch.where(on, stood, torch.where(fresh, 0.0, self.stood))
        self.drifted = torch.where(standing, (self.offset - self._anchor)[..., :2].norm(dim=-1), 0.0)
        low = (self._low & ~fresh) | (self.height < WENT_LOW) & (level < 2.0)
        up = low & (self.height > WENT_UP) & on
        self.aborts = torch.where(fresh, 0.0, self.aborts + up)
        self._low = low & ~up
        self.time = torch.where(fresh, 0.0, self.time + dt * (on & ~self.touched))

    def perceive(self, due: Due) -> None:
        """Read the instruments."""
        self.own.read(due)

    def conclude(self, due: Due) -> None:
        """Drop the pilot's velocity, for the aircraft know more."""
        self._wanted = None

    @property
    def known_height(self) -> Tensor:
        """Estimated height of the soles above the deck's plane, m."""
        return self.known_deck.above - self.soles_below

    def ends(self) -> dict[str, Tensor]:
        """Reasons why an aircraft's episode has ended, bool each."""
        limits = self.mission.config.landing
        hard = self.touched & (self.touch_speed > limits.hard_speed)
        hard |= self.touching & (self.touch_tilt > math.radians(limits.hard_tilt_deg))
        toppled = self.touched & (self.tilt > math.radians(limits.toppled_tilt_deg))
        slid = self.drifted > limits.drift
        ended = hard | toppled | slid
        return {
            "landed": (self.stood >= limits.stand - 1e-6) & ~ended,
            "hard": hard,
            "toppled": toppled & ~hard,
            "slid": slid & ~hard & ~toppled,
        }

    # -- learning --------------------------------------------------------------------------------------------------

    def plan_cost(self, ended: Tensor) -> Tensor:
        """Minus the reward, in which a landing differs from other endings."""
        ends = {name: flag & ended for name, flag in self.endings().items()}
        return -self.reward(Endings(ends | {COLLIDED: ended}))

    def endings(self) -> dict[str, Tensor]:
        """Landed, or the way in which it failed to."""
        ends = self.ends()
        late = (self.steps >= self.mission.config.episode_steps).unsqueeze(-1) & ~ends["landed"]
        return ends | {"late": late}

    def gives_up(self) -> dict[str, Tensor]:
        """Time is up for one that has not come down; whether real aircraft touched hard, toppled or met the sea is not
        for telemetry to tell.
        """
        return {"late": self.endings()["late"]}

    @property
    def rests(self) -> Tensor:
        """Whether each aircraft stands on its deck and does not sink, bool [env, aircraft]."""
        sinks = self.fleet.velocity_n[..., DOWN] - self.deck.velocity[..., DOWN]
        return self.standing & (sinks.abs() < STILL)

    @property
    def stopped_down(self) -> Tensor:
        """One that rests is held down, one that is near its deck rises from it; [env, aircraft], m/s."""
        near = (self.height < RISE) & (self.offset[..., :2].norm(dim=-1) < RISE)
        held = torch.where(self.rests, self.model.demands.descent, torch.where(near, -RISING, 0.0))
        return held.to(self.height)

    def log(self, ended: Endings) -> dict[str, Tensor]:
        """Shares of aircraft whose episodes ended in this step by a landing and by a failure, and this step's
        touchdowns.
        """
        landed, over = ended["landed"].float().sum(), ended.any.float().sum()
        touches = self.touching.float().sum().clamp(min=1.0)
        return {
            "landed": landed / self.distance.numel(),
            "failed": (over - landed) / self.distance.numel(),
            "touch_error_m": torch.where(self.touching, self.touch_error, 0.0).sum() / touches,
            "touch_speed": torch.where(self.touching, self.touch_speed, 0.0).sum() / touches,
        }

    def info(self) -> dict[str, Tensor]:
        """Height above the deck, and distance from the deck's middle, m."""
        return {"height": self.height, "distance": self.distance}

    def observe(self) -> dict[str, Tensor]:
        """Observation terms of each aircraft, in the level frame of its deck."""
        known, own, mission = self.known_deck, self.own, self.mission
        vectors = [known.to, known.velocity, known.acceleration, own.velocity_n, own.R_nb[..., BELOW]]
        if self.section.correction is not None:
            vectors.append(self.wanted - own.velocity_n)
        c, s = known.heading
        level = into_level(torch.stack(vectors, dim=-2), (c.unsqueeze(-1), s.unsqueeze(-1)))
        to, deck_v, deck_a, own_v, up, *wanted = level.unbind(-2)
        height = self.known_height.unsqueeze(-1)
        left = 1 - mission.steps.to(to).view(-1, 1, 1) / mission.config.episode_steps
        terms = {
            "to": squashed(to, FAR),
            "to_near": (to[..., :2] / NEAR).clamp(-1.0, 1.0),
            "height": squashed(height, 2.0),
            "height_near": (height / NEAR).clamp(-0.5, 1.0),
            "relative_velocity": squashed(deck_v - own_v, SLOW),
            "velocity": squashed(own_v, FAST),
            "deck_velocity": squashed(deck_v, SLOW),
            "deck_acceleration": squashed(deck_a, 1.0),
            "deck_past": squashed(known.past[..., list(LAGS)], SLOW),
            "deck_tilt": 5.0 * known.attitude[..., :2],
            "deck_rates": 2.0 * known.rates,
            "tilt": 2.0 * up[..., :2],
            "rates": own.angular_velocity_b[..., :2],
            "ages": torch.stack((squashed(known.seen, 1.0), squashed(known.heard, 1.0)), dim=-1),
            "time_left": left.expand_as(height),
            "standing": torch.stack((self.touched, self.standing), dim=-1).to(to),
            "previous_action": self.action[..., :3],
        }
        if wanted:
            terms["reference"] = squashed(wanted[0], SLOW)
        return terms

    def truth_now(self) -> Tensor | None:
        """Ground truth [env, aircraft, n]: deck, wind, wave height, tilt to the deck, time on it, and what varies."""
        mission, deck, fleet = self.mission, self.deck, self.fleet
        to = into_level(deck.place - fleet.position_n, deck.heading)
        relative = into_level(deck.velocity - fleet.velocity_n, deck.heading)
        wind = into_level(mission.world.around.wind.unsqueeze(1).expand_as(to), deck.heading)
        told = [
            squashed(to, FAR), (to / NEAR).clamp(-1.0, 1.0), squashed(relative, SLOW), deck.velocity[..., 2:],
            wind / 10.0, mission.hs.view(-1, 1, 1).expand_as(to[..., :1]) / 4.0, self.tilt.unsqueeze(-1),
            self.stood.unsqueeze(-1) / 5.0,
        ]  # fmt: skip
        if mission.config.varies:
            told.append(mission.world.truth[self.name])
        return torch.cat(told, dim=-1)


class SensingAircraft(Aircraft):
    """Aircraft that know their decks by the marker and the boats' messages."""

    def __init__(self, mission: LandingHost, name: str, decks: Decks, radio: Radio):
        """Prepare team `name`, whose aircraft come after the boats of `decks` in `radio`."""
        super().__init__(mission, name, decks)
        sensors = self.section.sensors
        tilted = sensors.errors * math.radians(sensors.imu.attitude_noise_deg)
        self.marker = self.remember(Marker(self.section.marker, self.own, tilted, mission.config.first_number(name)))
        self._radio = radio

    def perceive(self, due: Due) -> None:
        """Read the instruments, and look at the markers."""
        super().perceive(due)
        self.marker.look(self.fleet, self.decks, self.mission.hs, due)

    @property
    def seen_marker(self) -> tuple[Tensor, Tensor]:
        """Whether each camera sees its marker, bool [env, aircraft]; where, from the aircraft, b, m, [.., 3]."""
        seen = self.marker.seen
        return seen[..., Look.VARIANCE] > 0, (self.own.R_nb.mT @ seen[..., : Look.VARIANCE, None]).squeeze(-1)

    def conclude(self, due: Due) -> None:
        """Update the known decks by the looks and by the messages of the boats."""
        super().conclude(due)
        self.known_deck.measure(due, self.own, self.marker.seen, self._radio.heard)
