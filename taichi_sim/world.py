"""The world: owns state, time and tables of all environments, and steps them.

A team without a policy (traffic, a ferry, a drifting object) is commanded by a script. The team's section names it,
`script = "module:Class"`; the module is searched like that of a plug-in (config/plugins.py). A mission simulates
scripted teams, but neither trains nor judges them.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Self, TypeVar

import torch
from numpy.typing import ArrayLike

from taichi_sim.config import ConfigError, WorldConfig
from taichi_sim.config.arguments import (
    ActionError,
    Envs,
    checked_action,
    environments,
    names,
    numbers,
    whole_number,
)
from taichi_sim.config.base import number, span
from taichi_sim.config.io import find_config, load_world, vehicle_file
from taichi_sim.config.plugins import load_class
from taichi_sim.errors import named
from taichi_sim.fleet import Fleet
from taichi_sim.kernels import runtime
from taichi_sim.kernels.conventions import EAST, QUATERNION, STATE_SIZE, SURFACE_SIZE
from taichi_sim.kernels.random import Keys, Noise
from taichi_sim.kernels.rotation import DERIVED_SIZE
from taichi_sim.models.catalogue import load_vehicle, step_of
from taichi_sim.models.contact.between_teams import Contacts
from taichi_sim.randomisation.conditions import realise
from taichi_sim.randomisation.variation import Variation
from taichi_sim.state.divergence_dump import Dump, save_dump
from taichi_sim.state.memory import Remembers
from taichi_sim.state.snapshot import Stateful, check_memory
from taichi_sim.surroundings.air import Wind
from taichi_sim.surroundings.around_vehicles import Surroundings
from taichi_sim.surroundings.sea.current import Current
from taichi_sim.vehicle import UnstableStepError, Vehicle

APART = 8.0  # collision radii between neighbours of a team that no mission has placed; assumed
OFF_UNIT = 1e-3  # tolerated difference of a quaternion's norm from 1
FEW = 32  # environments that are placed at once and whose surroundings are kept; assumed
A = TypeVar("A")
_vehicles: Mapping[str, Vehicle] = {}  # of the world of which a copy is being made, by team


class Script(Remembers, ABC):
    """Contract of a script, which commands the team `name` of a world.

    State that it keeps between steps is saved and copied with the world; memory.py explains how.
    """

    def __init__(self, world: "World", name: str):
        """Take a team that `world` has just added; later teams do not exist yet."""
        self.name = name

    def begin(self, world: "World", envs: torch.Tensor) -> None:
        """Place the team's vehicles in environments `envs` [n], where an episode begins (`world.place`).

        Sea, time, current and wind of these environments have been drawn. Default: the vehicles stay where they are.
        """

    @abstractmethod
    def __call__(self, world: "World") -> ArrayLike | torch.Tensor:
        """Actions [env, vehicle, action] in [-1, 1] for the coming step."""


class World(Stateful):
    """A sea, an atmosphere, and teams of vehicles, in `num_envs` environments that share only tables.

    Attributes:
        sea: the realisations.
        env_sea: int32 [env], realisation of each environment.
        time: float64 [env], s.
        teams: name -> Fleet, the simulated teams.
        scripts: name -> script that acts for a team.
        conditions: conditions of each realisation (randomisation/conditions.py); `renew` gives them to environments.
        current, wind: those of each environment.
        around: surroundings at the surface, as of the last step.
        noise: counter of the turbulence's random numbers: control steps since the world was made, through all episodes.
        truth: team -> [env, vehicle, n], run precision, of order one: privileged information, such as for a critic. It
            holds the numbers of the vehicles and the conditions as drawn for the episode. `renew` writes it in place;
            its width in a scenario does not depend on `variation`.
        truth_names: team -> n names.
        contacts: teams with legs and the decks that may carry them (contact/between_teams.py).
        dump_folder: folder for the last step of an environment whose state is no longer finite (divergence_dump.py);
            None: no dumps.
    """

    @runtime.torch_at_rest()
    def __init__(
        self,
        config: WorldConfig,
        num_envs: int = 1,
        *,
        seed: int | None = None,
        teams: Sequence[str] | None = None,
        source: Path | None = None,
    ):
        """Build a world from a configuration.

        Vehicles begin at rest at the origin, all of a team at the same place: only a mission or a script knows where
        they should be. `place` moves them; `from_scenario` puts them apart.

        Args:
            config: that of a world or a scenario.
            num_envs: number of environments.
            seed: seed of the seas; default: config.seed.
            teams: teams to simulate; default: all.
            source: file beside which vehicle files are searched.
        """
        run = runtime.current()
        self.num_envs = num_envs = whole_number(num_envs, "num_envs", 1)
        self.config, self._source = config, source and source.resolve()
        self.seed = whole_number(config.seed if seed is None else seed, "seed")
        models = {name: self._model(name) for name in (config.teams if teams is None else names(teams, "teams"))}
        self._check_memory(models)
        self.sea, self.conditions = realise(config, self.seed)
        self._highest_crests = torch.as_tensor(self.sea.components.amplitude.sum(axis=1)).to(run.device)  # [sea], m
        self.current = self.remember(Current(config.sea.current, num_envs, self.seed, config.sea.depth))
        self.wind = self.remember(Wind(config.air, num_envs, self.seed))
        self.dump_folder: Path | None = None
        self.noise, self.keys = self.remember(Noise(num_envs, self.seed)), Keys()
        self.env_sea = self.remember((torch.arange(num_envs, device=run.device) % self.sea.num_seas).to(torch.int32))
        self._seas_of = self.scratch(-1)  # version of `env_sea` that has been checked
        self.time = self.remember(torch.zeros(num_envs, dtype=torch.float64, device=run.device))
        self._phase = self.remember(self.sea.phases(self.env_sea, self.time))
        self._variation = self.remember(Variation(config, self.conditions, num_envs, self.seed))
        self.around = self.remember(self._surroundings(self.current.velocity, self.wind.velocity))
        self.teams: dict[str, Fleet[Vehicle]] = self.remember({})
        self.scripts: dict[str, Script] = self.remember({})
        self._felt: dict[str, tuple[Surroundings, float, float]] = self.remember({})
        self._few: dict[tuple[str, int], Surroundings] = self.scratch(
            {}
        )  # by team and number of environments: _placing
        self.truth, self.truth_names = self._variation.truth, self._variation.names
        for name, model in models.items():
            self._add_team(name, model)
        self.contacts = self.remember(Contacts(self.teams, config.decision_interval))
        everywhere = self._everywhere = torch.arange(num_envs, device=run.device)
        self._variation.begin(everywhere, self.env_sea, self.current, self.wind)
        self._follow(everywhere)
        for script in self.scripts.values():
            script.begin(self, everywhere)

    def _alike(self, num_envs: int) -> Self:
        """Another world of the same configuration, seed, teams and vehicles."""
        with self.same_vehicles():
            return type(self)(self.config, num_envs, seed=self.seed, teams=tuple(self.teams), source=self._source)

    @contextmanager
    def same_vehicles(self) -> Iterator[None]:
        """Within this context, new worlds have the vehicles of this one, whatever their files say by now."""
        global _vehicles
        before, _vehicles = _vehicles, {name: fleet.model for name, fleet in self.teams.items()}
        try:
            yield
        finally:
            _vehicles = before

    def __repr__(self) -> str:
        """Size, time and teams; present sea, current and wind."""
        teams = (f"{name} ({fleet.count} x {type(fleet.model).__name__})" for name, fleet in self.teams.items())
        size = f"{number(self.num_envs, 'environment')}, t = {span(self.time, 's')}"
        flow, air = (span(x.velocity.norm(dim=-1), "m/s") for x in (self.current, self.wind))
        text = f"{size}, {', '.join(teams) or 'no teams'};\n {self.sea}, current {flow}, wind {air}"
        return f"<World {self.config.name!r}: {text}>"

    def _surroundings(self, current: torch.Tensor, wind: torch.Tensor) -> Surroundings:
        table, depth = self.sea.table, self.sea.kernel_depth
        return Surroundings(
            table, self.env_sea, self._phase, current, wind, depth, self.wind, self.noise,
            turbulence=self._variation.turbulence,
        )  # fmt: skip

    def _model(self, name: str) -> Vehicle:
        """The vehicle model of the team of that name."""
        if name not in self.config.teams:
            raise ValueError(f"there is no team {name!r}: allowed are {', '.join(self.config.teams) or 'none'}")
        if name in _vehicles:
            return _vehicles[name]
        section = self.config.teams[name]
        file = vehicle_file(section, self._source)
        substeps = self.config.substeps(name, step_of(file))
        try:
            model = load_vehicle(file, self.config.decision_interval / substeps, substeps, source=self._source)
        except UnstableStepError as error:
            key = "dt" if self.config.dt else f"{name}.dt" if section.dt else "dt of the vehicle file"
            raise ConfigError(f"{key}: {error}") from None
        if section.medium not in (None, model.medium):
            raise ConfigError(
                f"{name}.vehicle = {section.vehicle!r} moves in {model.medium}, and {name}.medium = "
                f"{section.medium!r}: name a vehicle of that medium"
            )
        return model

    def _check_memory(self, models: Mapping[str, Vehicle]) -> None:
        """Refuse more environments than memory can hold."""
        each = self.config.sea.components
        for name, model in models.items():
            each += self.config.teams[name].count * (STATE_SIZE + DERIVED_SIZE + SURFACE_SIZE + model.aux_size)
        check_memory(each * runtime.current().torch_dtype.itemsize, self.num_envs)

    def _add_team(self, name: str, model: Vehicle) -> None:
        """Add the team of that name to the simulation."""
        section, source = self.config.teams[name], self._source
        self.teams[name] = fleet = Fleet(name, model, self.num_envs, section.count)
        self._variation.add(fleet)
        if section.script is not None:
            with named(f"{name}.script = ", ConfigError):
                kind = load_class(section.script, Script, [source.parent] if source else [])
            self.scripts[name] = kind(self, name)  # pyright: ignore[reportAbstractUsage]
        water, air = self.current.mean_factor(model.draft), self.wind.speed_factor(model.wind_height)
        felt = self.around
        if (water, air) != (1.0, 1.0):
            felt = self._surroundings(
                self.around.current if water == 1.0 else self.around.current * water,
                self.around.wind if air == 1.0 else self.around.wind * air,
            )
        self._felt[name] = felt, water, air

    @classmethod
    def from_scenario(cls, scenario: str | Path = "paper", num_envs: int = 1, overrides=(), **options) -> "World":
        """World of a scenario's file or name, without its mission: `World.from_scenario("paper", num_envs=16)`.

        Vehicles of a team begin abreast, the first at the origin, the others east of it. `options` are the
        constructor's.
        """
        world = cls(load_world(scenario, overrides), num_envs, source=find_config(scenario), **options)
        for fleet in (fleet for name, fleet in world.teams.items() if name not in world.scripts):
            apart = APART * fleet.model.collision_radius
            fleet.state[..., EAST] = apart * torch.arange(fleet.count, device=fleet.state.device)
            fleet.update()
        return world

    @runtime.torch_at_rest()
    def step(self, actions: Mapping[str, ArrayLike | torch.Tensor] | None = None) -> dict[str, torch.Tensor]:
        """Advance every environment by one decision interval; return the actions as taken (clipped).

        Args:
            actions: team name -> [env, vehicle, action] in [-1, 1], a tensor or an array; clipped to that range. Every
                team without a script needs an entry; an entry for a team with a script replaces the script.

        Raises:
            ValueError: for a wrong shape, or an action that is not finite; nothing has moved then. A script whose
                action is refused has advanced.
            ProgramError: if Taichi runs in another precision or on another architecture than when the world was made,
                or somebody else has ended its program.
        """
        return self.advance(self.checked(actions))

    def advance(self, actions: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
        """`step` under actions that have been `checked`."""
        self.let_scripts_act(actions)
        self._advance(actions)
        return actions

    def let_scripts_act(self, actions: dict[str, torch.Tensor]) -> None:
        """Add the actions of teams with a script, where there are none."""
        for name, script in self.scripts.items():
            if name not in actions:
                actions[name] = self.checked_action(name, script(self), f"the script of {name}")

    def _advance(self, checked: dict[str, torch.Tensor]) -> None:
        """Make a step under the actions of all teams."""
        self._check_seas()
        self.sea.phases(self.env_sea, self.time, out=self._phase)
        before, touch = {}, {}
        if self.dump_folder:
            before = {
                name: (fleet.state.clone(), fleet.aux.clone(), fleet.remainder.clone())
                for name, fleet in self.teams.items()
            }
            touch = self.contacts.remembered()
        self._move(checked)
        if self.dump_folder:
            self._dump_faults(before, touch, checked, self.dump_folder)
        self._pass_time()

    def checked(self, actions: Mapping[str, ArrayLike | torch.Tensor] | None) -> dict[str, torch.Tensor]:
        """Actions that `step` would take, clipped, in run precision; nothing moves."""
        return {name: self.checked_action(name, action) for name, action in self.by_team(actions).items()}

    def by_team(self, actions: Mapping[str, A] | None) -> Mapping[str, A]:
        """`actions`, which need an entry for each team without a script, and none for a team that does not exist."""
        given = {} if actions is None else actions
        if not isinstance(given, Mapping):
            raise ActionError(f"actions are a {type(given).__name__}, expected is a dictionary by team")
        if not self.teams.keys() - self.scripts.keys() <= set(given) <= self.teams.keys():
            raise ActionError(f"actions are for {sorted(given)}, expected one tensor for each of {sorted(self.teams)}")
        return given

    def _move(self, actions: Mapping[str, torch.Tensor]) -> None:
        """Step all vehicles; those with legs after those with decks."""
        met, held = not self.contacts, self.contacts.begin()
        for name in self.contacts.ordered(self.teams):
            if not met and name in self.contacts.legged:
                self.contacts.meet(held)
                met = True
            fleet = self.teams[name]
            fleet.action.copy_(actions[name])
            fleet.model.step(fleet, self.felt(name))
        self.contacts.end()

    def _pass_time(self) -> None:
        """Advance all clocks by the decision interval."""
        self.time += self.config.decision_interval
        self.noise.tick()
        self.current.advance(self.config.decision_interval)
        self.wind.advance(self.config.decision_interval)
        self._follow(self._everywhere)

    def _follow(self, envs: torch.Tensor) -> None:
        """Update currents and winds that are given over time to the times of environments `envs` [n]."""
        self.current.follow(envs, self.time[envs])
        self.wind.follow(envs, self.time[envs])

    @runtime.own_settings()
    def renew(self, envs: Envs) -> None:
        """Begin an episode in environments `envs`, whose realisation of the sea (`env_sea`) has been drawn.

        They get the conditions of that realisation, new slow variations of current and wind, and vehicles with their
        own numbers. Scripted teams are placed. `envs` are numbers [n] or a bool mask [env].

        Raises:
            ValueError: for environments that do not exist or are named twice; nothing has changed then.
        """
        rows = environments(envs, self.num_envs, whole=True)
        self._variation.begin(rows, self.env_sea[rows], self.current, self.wind)
        self._follow(rows)
        self.current.reset(rows)
        self.wind.reset(rows)
        for script in self.scripts.values():
            script.begin(self, rows)

    def reseed(self, seed: int) -> None:
        """Make later draws depend on `seed` alone: slow variations and turbulence, numbers of vehicles.

        The realisations of the sea and their conditions stay.
        """
        seed = whole_number(seed, "seed")
        self.current.reseed(seed)
        self.wind.reseed(seed)
        self._variation.reseed(seed)
        self.noise.tick(seed - self.noise.clock)

    def felt(self, team: str) -> Surroundings:
        """Surroundings that `team` feels: the current averaged over its draft, the wind at its height."""
        felt, water, air = self._felt[team]
        if water != 1.0:
            torch.mul(self.around.current, water, out=felt.current)
        if air != 1.0:
            torch.mul(self.around.wind, air, out=felt.wind)
        return felt

    def _dump_faults(self, before, touch, actions: Mapping[str, torch.Tensor], folder: Path) -> None:
        """Write a dump for every environment whose state has just become not finite."""
        for name, fleet in self.teams.items():
            fine = fleet.state.sum(dim=(1, 2)).isfinite()
            if bool(fine.all()):
                continue
            fine_before = before[name][0].sum(dim=(1, 2)).isfinite()
            for env in (fine_before & ~fine).nonzero().flatten().tolist():
                dump = Dump(
                    config=self.config,
                    seed=self.seed,
                    env=int(self.noise.keys[env]),
                    sea=int(self.env_sea[env]),
                    time=float(self.time[env]),
                    clock=self.noise.clock,
                    current=self.around.current[env].clone(),
                    wind=self.around.wind[env].clone(),
                    states={key: value[0][env].clone() for key, value in before.items()},
                    aux={key: value[1][env].clone() for key, value in before.items()},
                    remainders={key: value[2][env].clone() for key, value in before.items()},
                    actions={key: value[env].clone() for key, value in actions.items()},
                    vary={key: {k: v[env] for k, v in f.vary.items()} for key, f in self.teams.items() if f.varied},
                    touch={team: {k: v[env] for k, v in each.items()} for team, each in touch.items()},
                    loads={key: f.load[env].clone() for key, f in self.teams.items() if f.loaded},
                    fault=f"{name}: the state is no longer finite",
                )
                save_dump(dump, folder)

    @runtime.own_settings()
    def place(self, name: str, envs: Envs, state: torch.Tensor) -> None:
        """Place the vehicles of a team in environments `envs` (numbers [n] or a bool mask) at `state` [n, vehicle, 13].

        The model brings them to rest or into trim (`Vehicle.settle`) in the sea, current and wind of those
        environments, so set `env_sea` and `time` first.

        Raises:
            ValueError: for an unknown team, environments that do not exist or are named twice, or a state of another
                shape, that is not finite, or whose quaternions are none; nothing has moved then.
        """
        if name not in self.teams:
            raise ValueError(f"there is no team {name!r}: there are {', '.join(self.teams) or 'none'}")
        fleet, rows = self.teams[name], environments(envs, self.num_envs, whole=True)
        state = numbers(state, f"{name}: the state").to(fleet.state)
        if tuple(state.shape) != (expected := (len(rows), *fleet.state.shape[1:])):
            raise ValueError(f"{name}: the state has shape {tuple(state.shape)}, expected {expected}")
        if not math.isfinite(state.sum()) and not state.isfinite().all():
            raise ValueError(f"{name}: the state at which to place vehicles is not finite")
        turned = state[..., QUATERNION].norm(dim=-1)
        if len(rows) and float((turned - 1.0).abs().max()) > OFF_UNIT:
            least, most = float(turned.min()), float(turned.max())
            raise ValueError(f"{name}: quaternions (w, x, y, z) have norms from {least:.3g} to {most:.3g}: attitudes "
                             "have 1; rotation.level_states makes states")  # fmt: skip
        if not len(rows):
            return
        self._check_seas()
        around = self._placing(name, rows)
        surface = fleet.surface[rows]
        state = fleet.model.settle(state, surface, around)
        aux = torch.empty((*state.shape[:-1], fleet.aux.shape[-1]), dtype=state.dtype, device=state.device)
        fleet.model.reset_aux(aux, state, around)
        fleet.surface.index_copy_(0, rows, surface)
        fleet.state.index_copy_(0, rows, state)
        fleet.remainder.index_fill_(0, rows, 0.0)
        fleet.aux.index_copy_(0, rows, aux)
        fleet.update(rows)
        self.contacts.place(fleet, rows)

    def _check_seas(self) -> None:
        """Refuse realisations in `env_sea` that do not exist, if somebody has written there, and another tensor."""
        if self.env_sea is not self.around.env_sea:
            raise ValueError("world.env_sea is another tensor now: write into it, world.env_sea[:] = ...")
        if self.env_sea._version != self._seas_of:
            self.sea.check(self.env_sea)
            self._seas_of = self.env_sea._version

    def _placing(self, name: str, envs: torch.Tensor) -> Surroundings:
        """Return the surroundings of a team in environments `envs` [n] alone.

        Those of few environments are kept: packing them takes longer than all else in placing.
        """
        felt, phase = self.felt(name), self.sea.phases(self.env_sea[envs], self.time[envs])
        kept = self._few.get((name, len(envs)))
        if kept is not None and kept.sea is felt.sea:
            kept.renew(felt, envs, phase)
            return kept
        made = felt.part(envs, phase)
        if len(envs) <= FEW:
            self._few[name, len(envs)] = made
        return made

    def elevation(self, envs: torch.Tensor, north: torch.Tensor, east: torch.Tensor) -> torch.Tensor:
        """Present elevation (m, up) in environments `envs` [n] at points [n, point] (north, east, m)."""
        env_sea = self.env_sea[envs]
        phase = self.sea.phases(env_sea, self.time[envs])
        points = torch.stack((north, east), dim=-1)
        rows = torch.arange(envs.shape[0], dtype=torch.int32, device=envs.device)
        rows = rows.unsqueeze(1).expand(north.shape).reshape(-1).contiguous()
        return self.sea.elevation_at(points.reshape(-1, 2), rows, env_sea, phase).reshape(north.shape)

    def elevation_below(self, team: Fleet, height: torch.Tensor) -> torch.Tensor:
        """Present elevation (m, up) under each vehicle of `team` that flies at `height` [env, vehicle] (m).

        For vehicles above any wave of their realisation of the sea it is -inf and costs nothing.
        """
        elevation = torch.full_like(height, -math.inf)
        highest = self._highest_crests[self.env_sea.long()].unsqueeze(1)
        env, vehicle = (height < highest).nonzero(as_tuple=True)
        if env.numel():
            place = team.position_n[env, vehicle]
            elevation[env, vehicle] = self.elevation(env, place[:, :1], place[:, 1:2]).squeeze(1)
        return elevation

    def checked_action(self, team: str, given: ArrayLike | torch.Tensor, by: str | None = None) -> torch.Tensor:
        """The actions of a team as `step` takes them; `by` says who gave them."""
        fleet = self.teams[team]
        size, names = (self.num_envs, fleet.count), fleet.model.action_names
        try:
            return checked_action(given, team, names, size, fleet.state.dtype)
        except ActionError as error:
            if by is None:
                raise
            raise ActionError(f"{by}: {error}") from None


def replay(dump: Dump, source: Path | None = None) -> World:
    """Run the step of a dump (divergence_dump.py) again, in a world of one environment; return the world after it.

    `source` is the scenario's file, beside which vehicle files are searched.
    """
    world = World(dump.config, 1, seed=dump.seed, teams=tuple(dump.states), source=source)
    world.env_sea[0], world.time[0] = dump.sea, dump.time
    only = torch.zeros(1, dtype=torch.int64, device=world.env_sea.device)
    world._variation.set_conditions(only, world.env_sea, world.current, world.wind)
    world.around.current[0], world.around.wind[0] = dump.current, dump.wind
    world.noise.keys[0] = dump.env
    world.noise.tick(dump.clock - world.noise.clock)
    for name, fleet in world.teams.items():
        fleet.state[0], fleet.aux[0] = dump.states[name], dump.aux[name]
        if name in dump.remainders:
            fleet.remainder[0] = dump.remainders[name]
        if name in dump.vary:
            fleet.set_numbers({key: value.unsqueeze(0) for key, value in dump.vary[name].items()})
        if name in dump.loads:
            fleet.load[0] = dump.loads[name]
        for memory, value in dump.touch.get(name, {}).items():
            assert fleet.touch is not None
            getattr(fleet.touch, memory)[0] = value
        fleet.update()
    world.step({name: action.unsqueeze(0) for name, action in dump.actions.items()})
    return world
