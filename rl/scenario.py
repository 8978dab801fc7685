"""Configuration of every scenario: a world, the mission in it, training stages, evaluation.

A mission's scenario class derives from `Scenario` and adds keys (rl/mission.py); rl/missions reads the file.
"""

import difflib
import hashlib
import itertools
from collections.abc import Iterator
from typing import Annotated, Literal, TypeVar

from pydantic import BeforeValidator, ConfigDict, Field

from taichi_sim.config import ConfigError, NonNegative, Positive, Strict, TeamConfig, WorldConfig
from taichi_sim.config.io import drop_ranges, set_values, validate
from taichi_sim.config.plausible import Plausible
from taichi_sim.config.vary import flattened

WHOLE = ("name", "seed", "mission", "stages", "evaluation")  # sections that are the same in all stages

PRETRAINED = "pretrained"  # the policies that come with the package
MOST_VEHICLES = 64  # of a team, among the random numbers of sensors


class ObserveConfig(Strict):
    """`[TEAM.observe]`: changes of what a team observes; every other key adds one, NAME = "module:function"."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, str] = Field(init=False)

    without: tuple[str, ...] = ()  # observations of its class that are left out

    @property
    def added(self) -> dict[str, str]:
        """Name -> module:function of each observation that is added."""
        return dict(self.__pydantic_extra__ or {})


class TeamSection(TeamConfig):
    """One team of a mission."""

    terms: dict[str, dict[str, object]] = {}  # its reward's terms: weight, numbers, function (rl/terms.py)
    observe: ObserveConfig | None = None


class PlanningConfig(Strict):
    """`[stages.NAME.planning]`: the stage improves its policy by planning, not by PPO (rl/learn/improvement.py).

    An iteration is `steps_per_iteration` decisions in `num_envs` environments, then `learning_epochs` over the
    planner's suggestions. `[TEAM.plan]` gives horizon and knots of the plans.
    """

    samples: Annotated[int, Field(ge=4, le=65536)] = 16  # futures tried for each plan
    spread: tuple[Positive, Positive] = (0.8, 0.3)  # standard deviation of a knot, of an action: first, last iteration
    step: Positive = 2.0  # factor on the suggested correction before the policy learns it
    rounds: Annotated[int, Field(ge=1, le=100)] = 8  # latest iterations whose suggestions the policy learns from


class StageConfig(Strict):
    """One training stage: the team that learns (others act by frozen weights), its environments, PPO's parameters.

    Several stages may train one team. A later stage continues from the end of the earlier one, with the same networks.
    Teams that neither learn nor are frozen do not take part.
    """

    team: Annotated[str, Field(min_length=1)]  # the team that learns
    joint: tuple[Annotated[str, Field(min_length=1)], ...] = ()  # other teams that learn at the same time
    frozen: tuple[Annotated[str, Field(min_length=1)], ...] | None = (
        None  # TEAM or TEAM=pretrained; default: all there are
    )
    keep: Literal["last", "better"] = "last"  # better: the stage is dropped if the team then does worse than before
    start_from: Annotated[str, Field(min_length=1)] | None = None  # weights (rl/learn/start_from.py)
    set: Annotated[dict[str, object], BeforeValidator(flattened)] = {}  # changes of the scenario in this stage, by key
    iterations: Annotated[int, Field(ge=1, le=1_000_000)] = 200
    num_envs: Annotated[int, Field(ge=1, le=1_000_000)] = 512
    steps_per_iteration: Annotated[int, Field(ge=2, le=1000)] = 24
    hidden_dims: Annotated[tuple[Annotated[int, Field(ge=1, le=4096)], ...], Field(min_length=1)] = (64, 64)
    activation: Literal["elu", "relu", "tanh"] = "elu"
    gru: Annotated[int, Field(ge=0, le=4096)] = 0  # units of a GRU before the actor's layers: its memory; 0: none
    learning_rate: Annotated[Positive, Plausible(1e-7, 0.1)] = 1e-3
    learning_epochs: Annotated[int, Field(ge=1, le=100)] = 2
    mini_batches: Annotated[int, Field(ge=1, le=1000)] = 8
    discount: Annotated[float, Field(gt=0, lt=1)] = 0.97
    gae_lambda: Annotated[float, Field(ge=0, le=1)] = 0.95
    clip: Annotated[Positive, Plausible(5e-3, 5.0)] = 0.2
    entropy: Annotated[NonNegative, Plausible(1e-7, 1.0)] = 0.0
    desired_kl: Annotated[Positive, Plausible(1e-5, 1.0)] = 0.01
    initial_std: Annotated[Positive, Plausible(5e-3, 20.0)] = 0.6
    critic: Literal["truth", "policy"] = "truth"  # input of the critic; truth: also privileged information
    planning: PlanningConfig | None = None
    checkpoint_interval: Annotated[int, Field(ge=1)] = 25  # iterations

    @property
    def learners(self) -> tuple[str, ...]:
        """All teams that learn in this stage."""
        return (self.team, *self.joint)

    @property
    def acting(self) -> tuple[str, ...] | None:
        """Teams that act frozen in this stage; None: all that were trained before."""
        return None if self.frozen is None else tuple(text.partition("=")[0] for text in self.frozen)


class Evaluation(Strict):
    """Held-out episodes."""

    episodes: Annotated[int, Field(ge=1, le=100_000)] = 256
    seed: Annotated[int, Field(ge=0)] = 1000
    settle: Annotated[NonNegative, Plausible(0.5, 2e3, "s")] = 20.0  # at the start of an episode that are not measured


class Scenario(WorldConfig):
    """A whole scenario: physics, mission, training, evaluation."""

    __pydantic_extra__: dict[str, TeamSection] = Field(init=False)

    name: Annotated[str, Field(min_length=1)]  # pyright: ignore[reportGeneralTypeIssues] (no default here)
    mission: Annotated[str, Field(min_length=1)] = "formation"  # a name in rl/missions, or module:Class
    episode_duration: Annotated[float, Field(gt=0, le=100_000), Plausible(1.0, 2e4, "s")] = 60.0
    stages: dict[str, StageConfig] = {}
    evaluation: Evaluation = Evaluation()
    replaced: tuple[str, ...] = ()  # what changed with a vehicle that an override has set (other_vehicle.py); written

    @property
    def episode_steps(self) -> int:
        """Decisions per episode."""
        return max(1, round(self.episode_duration / self.decision_interval))

    @property
    def trained(self) -> tuple[str, ...]:
        """Teams that some stage trains, in the order of the file."""
        learning = {team for stage in self.stages.values() for team in stage.learners}
        return tuple(name for name in self.teams if name in learning)

    @property
    def given(self) -> dict[str, str]:
        """Teams that act by a policy of the package, as a stage's `frozen` says: team -> TEAM=pretrained."""
        texts = (text for stage in self.stages.values() for text in stage.frozen or ())
        return {text.partition("=")[0]: text for text in texts if "=" in text}

    @property
    def acting(self) -> tuple[str, ...]:
        """Teams that act by policies, trained ones and given ones, in the order of the file."""
        return tuple(name for name in self.teams if name in self.trained or name in self.given)

    @property
    def corrected(self) -> tuple[str, ...]:
        """Trained teams whose policies correct a classical controller: by the section `residual` (rl/guidance)."""
        found = {name: getattr(self.teams[name], "residual", None) for name in self.trained}
        return tuple(name for name, residual in found.items() if residual is not None and residual.velocity > 0)

    @property
    def functions(self) -> set[str]:
        """The module:function of each term and observation that it adds, in its stages, too."""
        scenarios = [self, *(at_stage(self, name) for name in self.stages)]
        sections = [of for each in scenarios for of in each.teams.values() if isinstance(of, TeamSection)]
        terms = {str(keys["function"]) for of in sections for keys in of.terms.values() if "function" in keys}
        return terms.union(*(of.observe.added.values() for of in sections if of.observe))

    def first_number(self, team: str) -> int:
        """Number of a team's first vehicle among the counted random numbers of sensors."""
        return MOST_VEHICLES * list(self.teams).index(team)

    def stage_of(self, team: str) -> StageConfig | None:
        """The stage that trains a team last, if there is one."""
        return next((stage for stage in reversed(self.stages.values()) if team in stage.learners), None)

    def iterations_before(self, name: str, team: str | None = None) -> int:
        """Iterations that `team` (default: that of the stage) has completed when stage `name` begins."""
        team = team or self.stages[name].team
        earlier = itertools.takewhile(lambda item: item[0] != name, self.stages.items())
        return sum(stage.iterations for _, stage in earlier if team in stage.learners)

    def _mistakes(self) -> Iterator[str]:
        yield from super()._mistakes()
        if not self.teams:
            yield "there is no team: a team is a section of any name that has a vehicle"
        yield from self._unfit_stages()

    def _unfit_learner(self, key: str, team: str) -> Iterator[str]:
        if team not in self.teams:
            close = difflib.get_close_matches(team, self.teams, n=1)
            hint = f", did you mean {close[0]!r}?" if close else ""
            yield f"{key}: there is no such team{hint}; allowed are {', '.join(map(repr, self.teams)) or 'none'}"
        if team in self.scripted:
            yield f"{key}: a script acts for it, nothing is to be learnt"

    def _unfit_stages(self) -> Iterator[str]:
        """Mistakes of stages; those without a network of their own get that of their team's first stage."""
        first: dict[str, tuple[str, StageConfig]] = {}
        for name, stage in self.stages.items():
            for key, team in (("team", stage.team), *((f"joint[{k}]", team) for k, team in enumerate(stage.joint))):
                yield from self._unfit_learner(f"stages.{name}.{key} = {team!r}", team)
                earlier, begun = first.setdefault(team, (name, stage))
                for own in ("hidden_dims", "activation", "gru", "critic"):
                    before, now = getattr(begun, own), getattr(stage, own)
                    if own not in stage.model_fields_set and before != now:
                        self.stages[name] = stage = stage.model_copy(update={own: before})
                    elif before != now:
                        yield (
                            f"stages.{name}.{own} = {now!r}: {team} goes on with the networks of stages.{earlier}, "
                            f"where that is {before!r}"
                        )
                if stage.gru and (stage.planning is not None or stage.mini_batches > stage.num_envs):
                    why = "planning improves none" if stage.planning else f"mini_batches at most {stage.num_envs}"
                    yield f"stages.{name}.gru = {stage.gru}: of actors with a memory, {why}"
                if stage.planning is not None and stage.joint:
                    yield f"stages.{name}.joint = {list(stage.joint)}: one team at a time is improved by planning"
                if stage.start_from is not None and begun is not stage:
                    yield (
                        f"stages.{name}.start_from = {stage.start_from!r}: {team} goes on from stages.{earlier}; only "
                        "the first stage of a team may start from elsewhere"
                    )
                if stage.keep == "better" and stage.start_from is None and begun is stage:
                    yield (
                        f"stages.{name}.keep = 'better': {team} has learnt nothing before, so there is nothing to "
                        "compare with; train it in an earlier stage, or give start_from"
                    )
            key = f"stages.{name}.frozen = {list(stage.frozen or ())}"
            for team in stage.acting or ():
                yield from self._unfit_learner(key, team)
                if team in stage.learners:
                    yield f"{key}: {team} learns in this stage"
                if team in self.trained and team in self.given:
                    yield f"{key}: {team} has a given policy, and a stage that trains it: leave one of them out"
                if team not in first and team not in self.given:
                    yield (
                        f"{key}: no stage before this one trains {team}; put one there, let it act by the package's "
                        f"policy ({team}=pretrained), or leave it out"
                    )
                if self.given.get(team, f"{team}={PRETRAINED}") != f"{team}={PRETRAINED}":
                    yield f"{key}: {self.given[team]!r}: the only policy of another place is {PRETRAINED}"
            if len(set(stage.acting or ())) < len(stage.acting or ()):
                yield f"{key}: names a team twice"
            if len(set(stage.learners)) < len(stage.learners):
                yield f"stages.{name}.joint = {list(stage.joint)}: names a team twice, or stages.{name}.team"


C = TypeVar("C", bound=Scenario)


def at_stage(config: C, name: str) -> C:
    """The scenario of stage `name`, with the changes of `stages.NAME.set`."""
    changes = config.stages[name].set
    if not changes:
        return config
    sources = {key: f"stages.{name}.set" for key in changes}
    if fixed := next((key for key in changes if key.split(".")[0] in WHOLE), None):
        whole = ", ".join(WHOLE)
        raise ConfigError(f"stages.{name}.set: {fixed} cannot differ in a stage: {whole} are of the whole run")
    data = config.model_dump(mode="json", exclude_none=True)
    drop_ranges(data, changes)
    set_values(data, changes, type(config), sources)
    return validate(type(config), data, config.name, sources)


def derive_seed(seed: int, *purpose: str | int) -> int:
    """A 31-bit seed for `purpose`: equal words give equal seeds, other words give unrelated ones."""
    digest = hashlib.sha256(repr((int(seed), *purpose)).encode()).digest()
    return int.from_bytes(digest[:4], "little") >> 1
