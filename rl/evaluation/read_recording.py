"""Reads the tables that a recording (.rrd) holds: the rows of each vehicle, and each episode's conditions.

A recording with several episodes has the caption of each as the root of its paths.
"""

# pyarrow makes its functions when it is imported.
# pyright: reportAttributeAccessIssue=false

import json
import re
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import pyarrow as pa
from pyarrow import compute
from rerun.chunk import RrdReader

from rl.runs.folder import RunError
from taichi_sim.errors import reading, refuse
from taichi_sim.visualisation.recording.rrd import APPLICATION
from taichi_sim.visualisation.recording.table import CONDITIONS, ENDING, TABLE

PLACE = re.compile(rf"/(?:(?P<caption>.+)/)?(?:{CONDITIONS}|world/(?P<team>[^/]+)/vehicle_(?P<vehicle>\d+))")


class Rows(NamedTuple):
    """The rows of one vehicle by time: column -> [row]."""

    team: str
    vehicle: int
    columns: Mapping[str, pa.Array]


class RecordedEpisode(NamedTuple):
    """The tables of one episode."""

    caption: str  # "" if there is one
    vehicles: list[Rows]
    conditions: Mapping[str, Any]  # key -> a number, or a list of a team's vehicles


def read_recording(file: Path) -> list[RecordedEpisode]:
    """The tables in a recording of this package."""
    with reading(file, RunError):
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            reader = RrdReader(file)
        ours = [store.application_id.startswith(APPLICATION) for store in reader.recordings()]
        ends = (told, "it is cut off: its end is missing")
        refuse(RunError, ends, (ours != [True], "not a recording of this package"))
        parts: dict[str, dict[tuple[str, int], list[pa.RecordBatch]]] = {}
        conditions: dict[str, Mapping[str, Any]] = {}
        for chunk in reader.stream():
            at = PLACE.fullmatch(chunk.entity_path)
            if at is None:
                continue
            batch, caption = chunk.to_record_batch(), at["caption"] or ""
            if at["team"] is None:
                conditions[caption] = json.loads(batch.column("TextDocument:text")[0][0].as_py())
            elif any(name.startswith(f"{TABLE}:") for name in batch.schema.names):
                key = at["team"], int(at["vehicle"])
                parts.setdefault(caption, {}).setdefault(key, []).append(batch)
        refuse(RunError, (not parts, "no table in it: it was recorded by an earlier version; `play` records anew"))
        vehicles = {
            caption: [Rows(*whose, _rows(batches)) for whose, batches in of.items()] for caption, of in parts.items()
        }
        return [RecordedEpisode(caption, of, conditions.get(caption, {})) for caption, of in vehicles.items()]


def _rows(batches: list[pa.RecordBatch]) -> dict[str, pa.Array]:
    """The columns of all batches of one vehicle, by time."""
    whole = pa.Table.from_batches(batches).sort_by("step").combine_chunks()
    found = {"time_s": compute.divide(whole["sim_time"].cast(pa.int64()), 1e9).combine_chunks()}
    for name in whole.schema.names:
        if name.startswith(f"{TABLE}:"):
            found[name.removeprefix(f"{TABLE}:")] = compute.list_flatten(whole[name]).combine_chunks()
    if ENDING in found:
        found[ENDING] = compute.if_else(compute.equal(found[ENDING], ""), None, found[ENDING])
    return found
