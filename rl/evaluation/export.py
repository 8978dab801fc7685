"""The episodes of an evaluation or of a recording as tables, for pandas and the like: vehicles' motion, and each
episode's conditions.

Parquet, or CSV by the file's suffix. Columns: docs/evaluation.md.
"""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pyarrow as pa
import torch
from numpy.typing import NDArray
from pyarrow import csv, parquet

from rl.evaluation.conditions import Conditions
from rl.evaluation.read_recording import read_recording
from rl.judge import Episodes, Judge
from rl.mission import Mission
from rl.step import Step
from taichi_sim.config.io import replacing
from taichi_sim.visualisation.recording.table import ENDING, MOTION, REWARD, column

ROWS = 1 << 20  # in memory, about
KEYS = {"episode": pa.int32(), "time_s": pa.float64(), "team": pa.string(), "vehicle": pa.int16()}
RESULTS = {REWARD: pa.float32(), ENDING: pa.string()}

Columns = Mapping[str, NDArray[np.generic] | pa.Array]


@contextmanager
def exported(file: Path) -> Iterator["Export"]:
    """An export to `file`, which is whole, under its own name, when the block ends; after an error an old one stays."""
    with replacing(file) as part:
        export = Export(part)
        try:
            yield export
        finally:
            export.close()


class Export:
    """Writes the motion of all episodes: a row for each decision and vehicle until its team ends, by time in chunks of
    episodes.
    """

    def __init__(self, file: Path):
        """Write to `file`."""
        self.file, self._schema, self._writer = file, pa.schema([]), None
        self._waiting: list[pa.Table] = []

    def chunk(self, mission: Mission, first: int) -> "Chunk":
        """What sees the decisions of a mission at the start of its episodes; environment 0 is episode `first`."""
        if self._writer is None:
            actions, series = {}, {}
            for name, team in mission.teams.items():
                actions |= dict.fromkeys(f"action {key}" for key in team.fleet.model.action_names)
                series |= dict.fromkeys(mission.Judge(mission, name).series())
            self.begin(map(column, (*MOTION, *actions, *series)))
        return Chunk(self, mission, first)

    def begin(self, numbers: Iterable[str]) -> None:
        """Begin the file; `numbers` are the columns beside those that every table has."""
        self._schema = pa.schema(list((KEYS | dict.fromkeys(numbers, pa.float32()) | RESULTS).items()))
        self._writer = _writer(self.file, self._schema)

    def add(self, columns: Columns) -> None:
        """Append rows; columns that are missing stay empty."""
        self._waiting.append(_table(columns, self._schema))
        if sum(map(len, self._waiting)) >= ROWS:
            self._write()

    def close(self) -> None:
        """Complete the file."""
        if self._writer is not None:
            self._write()
            self._writer.close()

    def _write(self) -> None:
        if self._waiting and self._writer is not None:
            self._writer.write_table(pa.concat_tables(self._waiting).combine_chunks())
            self._waiting.clear()


class Chunk:
    """The part of an export that a chunk of episodes gives."""

    def __init__(self, export: Export, mission: Mission, first: int):
        """Give the decisions of a mission to an export."""
        self.export, self.mission, self.first = export, mission, first

    def see(self, judges: Mapping[str, Judge], step: Step, number: int) -> None:
        """Export decision `number` (from 1); call this before the judges see the decision."""
        for name, judge in judges.items():
            fleet, envs = self.mission.teams[name].fleet, np.flatnonzero(~judge.failed)
            motion = torch.cat((fleet.position_n, fleet.euler, fleet.velocity_b, fleet.angular_velocity_b), -1)
            series, count = judge.series(), len(envs) * fleet.count
            labels = [*MOTION, *(f"action {key}" for key in fleet.model.action_names), *series]
            values = (*motion.unbind(-1), *self.mission.teams[name].action.unbind(-1), *series.values())
            self.export.add({
                "episode": np.repeat(self.first + envs, fleet.count).astype(np.int32),
                "time_s": np.full(count, round(number * self.mission.config.decision_interval, 6)),
                "team": pa.repeat(name, count),
                "vehicle": np.tile(np.arange(fleet.count, dtype=np.int16), len(envs)),
                **{column(label): value.float().cpu().numpy()[envs].ravel()
                   for label, value in zip(labels, values, strict=True)},
                REWARD: step.reward[name].float().cpu().numpy()[envs].ravel(),
                ENDING: pa.array(step.endings[name].why()[envs].ravel(), pa.string()),
            })  # fmt: skip


def export_conditions(file: Path, conditions: Conditions, episodes: Mapping[str, Episodes]) -> Path:
    """Write the table of episodes beside that of their motion, `file`: a row for each, with its conditions as drawn,
    the numbers of its vehicles that vary, and what the judge measured of each team.
    """
    columns: dict[str, NDArray[np.generic]] = {}
    for key, value in conditions.items():
        columns |= {key: value} if value.ndim == 1 else {f"{key}.{k}": of for k, of in enumerate(value.T)}
    columns |= {f"{team}.{name}": value for team, of in episodes.items() for name, value in of.items()}
    columns = {"episode": np.arange(len(next(iter(columns.values()))), dtype=np.int32)} | columns
    schema = pa.schema([(name, pa.from_numpy_dtype(value.dtype)) for name, value in columns.items()])
    beside = file.with_stem(f"{file.stem}_conditions")
    with replacing(beside) as part:
        writer = _writer(part, schema)
        writer.write_table(_table(columns, schema))
        writer.close()
    return beside


def export_recording(file: Path, recording: Path) -> Path:
    """Write the table of a recording (.rrd) to `file`, and that of its episodes' conditions beside it."""
    episodes = read_recording(recording)
    found = dict.fromkeys(name for episode in episodes for of in episode.vehicles for name in of.columns)
    with exported(file) as export:
        export.begin(name for name in sorted(found, key=_place) if name not in (*KEYS, *RESULTS))
        for number, episode in enumerate(episodes):
            for of in episode.vehicles:
                keys = {"episode": np.int32(number), "team": of.team, "vehicle": np.int16(of.vehicle)}
                rows = len(of.columns["time_s"])
                export.add({**{name: pa.repeat(value, rows) for name, value in keys.items()}, **of.columns})
    keys = dict.fromkeys(key for episode in episodes for key in episode.conditions)
    conditions = {key: np.array([episode.conditions.get(key, np.nan) for episode in episodes]) for key in keys}
    return export_conditions(file, {"recording": np.array([episode.caption for episode in episodes])} | conditions, {})


def _place(name: str) -> tuple[int, int]:
    """Where a column stands: motion, actions, the rest."""
    motion = [column(label) for label in MOTION]
    return (0, motion.index(name)) if name in motion else (1 if name.startswith("action_") else 2, 0)


def _table(columns: Columns, schema: pa.Schema) -> pa.Table:
    count = len(next(iter(columns.values())))
    return pa.table(
        [pa.array(columns[f.name], f.type) if f.name in columns else pa.nulls(count, f.type) for f in schema],
        schema=schema,
    )


def _writer(file: Path, schema: pa.Schema) -> csv.CSVWriter | parquet.ParquetWriter:
    return csv.CSVWriter(file, schema) if file.suffix == ".csv" else parquet.ParquetWriter(file, schema)
