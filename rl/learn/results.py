"""What summary.json says of a stage."""

from typing import NotRequired, TypedDict


class Verdict(TypedDict):
    """Comparison of a stage that has `keep = "better"` with the policies before it."""

    kept: bool
    loss_before: float
    loss: float


class Batch(TypedDict, total=False):
    """How many processes and environments a stage has used from iteration `since_iteration` on."""

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
