"""series.parquet: what every robot had become and done by each sample, one row for each robot and time."""

import json
from collections.abc import Iterator, Mapping, Sequence
from io import BytesIO
from typing import NamedTuple

import numpy as np
from arro3.core import Array, DataType, Field, RecordBatch, RecordBatchReader, Schema
from arro3.io import write_parquet
from numpy.typing import NDArray

from eval.judge.monitors import MONITORS
from eval.soak.configuration import Soak
from eval.soak.fingerprint import code_digest
from eval.soak.shard import ShardResult
from robots.distributions import load_distributions

SERIES = "series.parquet"
FORMAT = 1
"""Of the columns and of what the file says of itself; a change of meaning is another number."""
ABOUT = "firstshift"
"""Key of the file's metadata, a single one, in JSON: of several, the writer keeps no order."""
WORN = (
    ("friction_{}", "1", "dry friction, as a factor of the new joint's"),
    ("backlash_{}_rad", "rad", "play of the gear, from stop to stop"),
    ("encoder_error_{}_rad", "rad", "by how much a slipping encoder is off"),
    ("torque_constant_{}", "1", "torque per ampere, as a factor of the new motor's"),
)
"""In the order of `ShardResult.worn`."""


class Column(NamedTuple):
    """One column: `values` (T, R), by time and robot."""

    unit: str
    meaning: str
    values: NDArray[np.generic]


def series(soak: Soak, shards: Sequence[ShardResult]) -> bytes:
    """The file: a function of what was asked for and lived through, not of when or how often it was begun.

    Robots are numbered as in report.json. Rows are in the order of robots, then of time; one that was cut short has
    fewer.
    """
    firsts = np.cumsum([0, *(shard.counts.robots for shard in shards)])
    tables = (columns(soak, shard, int(first)) for shard, first in zip(shards, firsts, strict=False))
    told = columns(soak, shards[0], 0)
    schema = Schema([Field(name, _type(column), nullable=False) for name, column in told.items()])
    reader = RecordBatchReader.from_batches(schema, (_batch(table, schema) for table in tables))
    file = BytesIO()
    write_parquet(reader, file, compression="zstd(3)", key_value_metadata={ABOUT: _about(soak, told)})
    return file.getvalue()


def columns(soak: Soak, shard: ShardResult, first: int) -> dict[str, Column]:
    """By name.

    Args:
        soak: what was asked for. shard: what came of robots `first` and on.
    """
    samples, robots = shard.running.shape
    hours, each = soak.spec.dt / 3600, np.ones((samples, robots), dtype=np.int64)
    begun = soak.sample_ticks * np.arange(samples)[:, None]
    return {
        "robot": Column("", "number of the robot, its draw", each * (first + np.arange(robots))),
        "time_h": Column("h", "simulated, since the start", each * begun * hours),
        "running_h": Column("h", "under way so far", shard.running * hours),
        "goals_attempted": Column("", "goals whose time was over so far", shard.attempted),
        "goals_reached": Column("", "of these, with the tool truly there", shard.reached),
        "stops": Column("", "times that it left its work so far", shard.stops),
        "latches": Column("", "times that it lost its power so far", shard.latches),
        **dict(_events(shard)),
        **dict(_joints(soak.spec.joint_names, shard)),
    }


def _events(shard: ShardResult) -> Iterator[tuple[str, Column]]:
    for k, monitor in enumerate(MONITORS):
        kind = "hard" if monitor.hard else "soft"
        meaning = f"{kind} events so far, all joints together: {monitor.meaning}"
        yield f"events_{monitor.name}", Column("", meaning, shard.events[..., k])


def _joints(names: Sequence[str], shard: ShardResult) -> Iterator[tuple[str, Column]]:
    unknown = "; NaN once the simulation diverged"
    for j, name in enumerate(names):
        yield f"winding_{name}_c", Column("°C", f"true temperature{unknown}", shard.winding_c[..., j])
        meaning = f"share of its current that its heat keeps from a motor at work{unknown}"
        yield f"folded_back_{name}", Column("1", meaning, shard.folded_back[..., j])
        for k, (title, unit, worn) in enumerate(WORN):
            yield title.format(name), Column(unit, f"{worn}{unknown}", shard.worn[:, k, :, j])


def _type(column: Column) -> DataType:
    return DataType.int64() if column.values.dtype.kind == "i" else DataType.float64()


def _batch(table: Mapping[str, Column], schema: Schema) -> RecordBatch:
    """Robot by robot."""
    arrays = [
        Array.from_numpy(np.ascontiguousarray(column.values.T.reshape(-1))) for column in table.values()
    ]
    return RecordBatch.from_arrays(arrays, schema=schema)


def _about(soak: Soak, told: Mapping[str, Column]) -> str:
    """What the file says of itself."""
    about = {
        "format": FORMAT,
        "seed": soak.seed,
        "robots": soak.robots,
        "hours": soak.hours,
        "sample_s": soak.sample_ticks * soak.spec.dt,
        "robot_digest": soak.spec.digest,
        "draws_digest": load_distributions(soak.spec).digest,
        "policy_digest": soak.policy.digest,
        "code_digest": code_digest(),
        "columns": {name: {"unit": column.unit, "meaning": column.meaning} for name, column in told.items()},
    }
    return json.dumps(about, ensure_ascii=False)
