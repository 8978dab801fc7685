"""The world: owns state, time and tables of all environments, and steps them."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import torch

from taichi_sim import runtime
from taichi_sim.air import Wind
from taichi_sim.air.wind import wind_speed
from taichi_sim.config import ScenarioConfig, SeaConfig
from taichi_sim.config.io import load_scenario, vehicle_file
from taichi_sim.conventions import ELEVATION, TEAMS
from taichi_sim.dump import Dump, save_dump
from taichi_sim.fleet import Team
from taichi_sim.sea import Sea
from taichi_sim.sea.current import Current
from taichi_sim.sea.wind_sea import CALM_PERIOD
from taichi_sim.surroundings import Surroundings
from taichi_sim.uav.fixed_wing.start import wind_at
from taichi_sim.vehicles import load_vehicle


class ActionError(ValueError):
    """An action that is not finite."""


class World:
    """A sea and two teams, in `num_envs` environments that share nothing but tables.

    Attributes:
        sea: the realisations. env_sea: int32 [env], which one each environment is on.
        time: float64 [env], s. teams: name -> Team, those simulated.
        current, wind: of each environment. around: what the vehicles are told of all three, as of the last step.
        dump_folder: where the last step of an environment whose state is no longer finite is written, to be replayed
            (dump.py); None is nowhere.
    """

    def __init__(
        self,
        config: ScenarioConfig,
        num_envs: int = 1,
        *,
        seed: int | None = None,
        teams: Sequence[str] = TEAMS,
        source: Path | None = None,
    ):
        """Build a world from a scenario.

        Args:
            config: the scenario. num_envs: environments. seed: of the seas; default config.seed.
            teams: which teams to simulate. source: the scenario's file, beside which vehicles are looked for.
        """
        run = runtime.current()
        self.config, self.num_envs = config, num_envs
        self.seed = config.seed if seed is None else seed
        self.sea = Sea.from_config(resolved_sea(config), self.seed)
        self._highest_crest = float(self.sea.components.amplitude.sum(axis=1).max())
        self.current = Current(config.sea.current, num_envs, self.seed, config.sea.depth)
        self.wind = Wind(config.air, num_envs, self.seed)
        self.dump_folder: Path | None = None
        self.env_sea = (torch.arange(num_envs, device=run.device) % self.sea.num_seas).to(torch.int32)
        self.time = torch.zeros(num_envs, dtype=torch.float64, device=run.device)
        still = Surroundings.of(self.sea, self.env_sea, self.time)
        self.around = still._replace(
            current=self.current.velocity, wind=self.wind.velocity, air=self.wind, seed=self.seed
        )
        self.teams: dict[str, Team] = {}
        for name in teams:
            file = vehicle_file(config.team(name), source)
            model = load_vehicle(file, name, config.dt, config.substeps)
            self.teams[name] = Team(name, model, num_envs, config.team(name).count)

    @classmethod
    def from_scenario(cls, scenario: str | Path = "paper", num_envs: int = 1, overrides=(), **options) -> "World":
        """A world from a scenario's file or name, for example `World.from_scenario("paper", num_envs=16)`."""
        from taichi_sim.config.io import find_config

        return cls(load_scenario(scenario, overrides), num_envs, source=find_config(scenario), **options)

    def step(self, actions: Mapping[str, torch.Tensor]) -> dict[str, torch.Tensor]:
        """Advance every environment by one decision interval; return the actions as taken (clipped).

        Args:
            actions: team name -> [env, vehicle, action] in [-1, 1]; clipped to that range.

        Raises:
            ValueError: for a wrong shape, or an action that is not finite; nothing has moved then.
        """
        if set(actions) != set(self.teams):
            raise ValueError(f"actions are for {sorted(actions)}, expected one tensor for each of {sorted(self.teams)}")
        checked = {name: self._checked(team, actions[name]) for name, team in self.teams.items()}
        self.sea.phases(self.env_sea, self.time, out=self.around.phase)
        before = self._remember() if self.dump_folder else {}
        for name, team in self.teams.items():
            team.model.step(team, checked[name], self._around(team, self.around))
        if self.dump_folder:
            self._dump_faults(before, checked, self.dump_folder)
        self.time += self.config.decision_interval
        self.around = self.around._replace(clock=self.around.clock + 1)
        self.current.advance(self.config.decision_interval)
        self.wind.advance(self.config.decision_interval)
        return checked

    def renew(self, envs: torch.Tensor) -> None:
        """Draw current and wind of environments `envs` [n] anew: an episode begins there."""
        self.current.reset(envs)
        self.wind.reset(envs)

    def _around(self, team: Team, around: Surroundings) -> Surroundings:
        """What `team` is told of `around`: a USV feels the current averaged over its draft, and the wind at its own
        height.
        """
        if team.name != "usv":
            return around
        water, air = self.current.mean_factor(team.model.draft), self.wind.speed_factor(team.model.wind_height)
        current = around.current if water == 1.0 else around.current * water
        return around._replace(current=current, wind=around.wind if air == 1.0 else around.wind * air)

    def _at(self, envs: torch.Tensor) -> Surroundings:
        """`around` of environments `envs` [n] alone, now."""
        env_sea = self.env_sea.index_select(0, envs)
        current, wind = (x.index_select(0, envs) for x in (self.around.current, self.around.wind))
        phase = self.sea.phases(env_sea, self.time.index_select(0, envs))
        return self.around._replace(env_sea=env_sea, phase=phase, current=current, wind=wind)

    def _remember(self) -> dict[str, tuple[torch.Tensor, torch.Tensor]]:
        return {name: (team.state.clone(), team.aux.clone()) for name, team in self.teams.items()}

    def _dump_faults(self, before, actions: Mapping[str, torch.Tensor], folder: Path) -> None:
        """Write a dump of every environment whose state has just stopped being finite."""
        for name, team in self.teams.items():
            fine_before = before[name][0].sum(dim=(1, 2)).isfinite()
            for env in (fine_before & ~team.state.sum(dim=(1, 2)).isfinite()).nonzero().flatten().tolist():
                dump = Dump(
                    config=self.config,
                    seed=self.seed,
                    env=self.around.first_env + env,
                    sea=int(self.env_sea[env]),
                    time=float(self.time[env]),
                    clock=self.around.clock,
                    current=self.around.current[env].clone(),
                    wind=self.around.wind[env].clone(),
                    states={key: value[0][env].clone() for key, value in before.items()},
                    aux={key: value[1][env].clone() for key, value in before.items()},
                    actions={key: value[env].clone() for key, value in actions.items()},
                    fault=f"{name}: the state is no longer finite",
                )
                save_dump(dump, folder)

    def place(self, name: str, envs: torch.Tensor, state: torch.Tensor) -> None:
        """Put the vehicles of a team in environments `envs` [n] at `state` [n, vehicle, 13].

        USVs are lifted onto the wave under them: set `env_sea` and `time` of those environments first. Models that
        `settle` (state [n, vehicle, 13], Surroundings of these n) begin afloat, moving with the water; those that have
        a `prepare` (state [n, vehicle, 13], wind [n, 3], Wind) begin in equilibrium.
        """
        team = self.teams[name]
        wind = self.wind.velocity.index_select(0, envs)
        flies = hasattr(team.model, "prepare")
        if flies:
            state = team.model.prepare(state, wind, self.wind)
        if hasattr(team.model, "settle"):
            state, aux, team.surface[envs] = team.model.settle(state, self._around(team, self._at(envs)))
        else:
            if name == "usv":
                state = state.clone()
                zeta = self.elevation(envs, state[..., 0], state[..., 1])
                state[..., 2] -= zeta
                team.surface[envs, :, ELEVATION] = zeta
            aux = torch.empty((*state.shape[:-1], team.aux.shape[-1]), dtype=state.dtype, device=state.device)
            team.model.reset_aux(aux, state)
            if flies:
                team.model.measure_air(aux, state, wind_at(state, wind, self.wind))
        team.state.index_copy_(0, envs, state)
        team.aux.index_copy_(0, envs, aux)
        team.update(envs)

    def elevation(self, envs: torch.Tensor, north: torch.Tensor, east: torch.Tensor) -> torch.Tensor:
        """Elevation (m, up) now in environments `envs` [n] at points [n, point]."""
        env_sea = self.env_sea[envs]
        phase = self.sea.phases(env_sea, self.time[envs])
        points = torch.stack((north, east), dim=-1)
        rows = torch.arange(envs.shape[0], dtype=torch.int32, device=envs.device)
        rows = rows.unsqueeze(1).expand(north.shape).reshape(-1).contiguous()
        return self.sea.elevation_at(points.reshape(-1, 2), rows, env_sea, phase).reshape(north.shape)

    def elevation_below(self, team: Team, height: torch.Tensor) -> torch.Tensor:
        """Elevation (m, up) now under each vehicle of `team` that flies at `height` [env, vehicle] (m).

        Of vehicles above any wave of this sea it is -inf, and costs nothing.
        """
        elevation = torch.full_like(height, -math.inf)
        env, vehicle = (height < self._highest_crest).nonzero(as_tuple=True)
        if env.numel():
            place = team.position_n[env, vehicle]
            elevation[env, vehicle] = self.elevation(env, place[:, :1], place[:, 1:2]).squeeze(1)
        return elevation

    def _checked(self, team: Team, action: torch.Tensor) -> torch.Tensor:
        shape = (self.num_envs, team.count, len(team.model.action_names))
        if tuple(action.shape) != shape:
            raise ValueError(f"{team.name} actions have shape {tuple(action.shape)}, expected {shape}")
        if not math.isfinite(action.sum()) and not torch.isfinite(action).all():
            env, vehicle, index = (~torch.isfinite(action)).nonzero()[0].tolist()
            raise ActionError(
                f"{team.name} action {team.model.action_names[index]!r} of vehicle {vehicle} in environment {env} "
                f"is {action[env, vehicle, index].item()}: actions must be finite"
            )
        return action.to(team.state.dtype).clamp(-1.0, 1.0).contiguous()


def resolved_sea(config: ScenarioConfig) -> SeaConfig:
    """The sea of a scenario, in which the wind has taken its place where the sea follows it."""
    sea = config.sea
    if not sea.follows_wind:
        return sea
    speed = wind_speed(config.air)
    size = {"wind_speed": speed} if speed > 0 else {"hs": 0.0, "tp": CALM_PERIOD, "fetch": None}
    return sea.model_copy(update=size | {"follows_wind": False, "direction_deg": config.air.direction_deg + 180.0})


def replay(dump: Dump, source: Path | None = None) -> World:
    """Run the step of a dump again, alone: the world after it, whose teams show what became of the vehicles.

    `source` is the scenario's file, beside which its vehicles are looked for.
    """
    world = World(dump.config, 1, seed=dump.seed, teams=tuple(dump.states), source=source)
    world.env_sea[0], world.time[0] = dump.sea, dump.time
    world.around.current[0], world.around.wind[0] = dump.current, dump.wind
    world.around = world.around._replace(clock=dump.clock, first_env=dump.env)
    for name, team in world.teams.items():
        team.state[0], team.aux[0] = dump.states[name], dump.aux[name]
        team.update()
    world.step({name: action.unsqueeze(0) for name, action in dump.actions.items()})
    return world
