"""Contents of a run's JSON files: meta.json, summary.json, evaluation/*.json, sweeps/*/sweep.json."""

from typing import NotRequired, TypedDict

Figures = dict[str, float | None]
"""Figure -> its value; None where nothing was measured."""


class Verdict(TypedDict):
    """Comparison of a stage that has `keep = "better"` with the policies before it."""

    kept: bool
    loss_before: float
    loss: float


class Batch(TypedDict, total=False):
    """Numbers of processes and environments from an iteration of a stage on."""

    since_iteration: int
    processes: int
    environments: int


class StageResult(TypedDict):
    """A stage in summary.json."""

    name: str
    team: str
    iterations: int
    agent_steps: int
    wall_time_s: float
    agent_steps_per_s: float
    processes: NotRequired[int]
    environments: NotRequired[int]
    batches: NotRequired[list[Batch]]  # of a stage that was resumed with other numbers
    joint: NotRequired[list[str]]
    verdict: NotRequired[Verdict]


class EvaluationResult(TypedDict):
    """Figures of an evaluation."""

    controller: str
    scenario: str
    seed: int
    episodes: int
    teams: dict[str, Figures]
    worst_episode: int
    median_episode: int


class Summary(TypedDict):
    """summary.json."""

    scenario: str
    seed: int
    wall_time_s: float
    processes: int
    stages: list[StageResult]
    evaluation: EvaluationResult


class Machine(TypedDict):
    """The machine of a run."""

    system: str
    cpus: int | None
    processor: str


class Software(TypedDict):
    """All besides configuration and seed that a result depends on."""

    packages: dict[str, str | None]
    git_commit: str | None
    python: str
    machine: Machine
    command: list[str]


class Meta(Software, total=False):
    """meta.json."""

    scenario_file: str
    seed: int
    scenario_digest: str


class AxisTable(TypedDict):
    """One axis of a sweep."""

    name: str
    unit: str
    values: list[object]


class CellResult(TypedDict):
    """Figures of one cell of a sweep."""

    cannot_be: dict[str, str]  # controller -> why it could not run
    teams: dict[str, dict[str, dict[str, list[float | None]]]]
    """Team -> controller or "difference" -> figure -> value, low, high."""


class CellRow(CellResult):
    """One cell in sweep.json."""

    values: dict[str, object]  # axis -> its value
    set: list[str]  # KEY=VALUE


class SweepAbout(TypedDict):
    """sweep.json without its cells."""

    sweep: str
    scenario: str
    seed: int
    episodes: int
    opponent: str
    grid: bool
    axes: list[AxisTable]


class SweepTable(SweepAbout):
    """sweep.json."""

    cells: list[CellRow]
