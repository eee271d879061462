"""series.parquet: goals, events, heat and wear over time, one row for each robot and sample."""

import json
from collections.abc import Iterator, Mapping, Sequence
from io import BytesIO
from typing import NamedTuple

import numpy as np
from arro3.core import Array, DataType, Field, RecordBatch, RecordBatchReader, Schema
from arro3.io import write_parquet
from numpy.typing import NDArray

from eval.judge.monitors import MONITORS
from eval.shard.job import code_digest
from eval.shard.judging import ShardResult
from eval.soak.configuration import SoakConfig

SERIES = "series.parquet"
FORMAT = 1
"""Version of the columns and metadata; it changes with their meaning."""
METADATA = "firstshift"
"""The only key of the file's metadata, in JSON: the writer does not keep the order of several keys."""
WORN = (
    ("friction_{}", "1", "dry friction, relative to the new joint"),
    ("backlash_{}_rad", "rad", "backlash of the gear, from stop to stop"),
    ("encoder_error_{}_rad", "rad", "offset of a slipped encoder"),
    ("torque_constant_{}", "1", "torque per ampere, relative to the new motor"),
)
"""In the order of `ShardResult.worn`."""


class Column(NamedTuple):
    """One column: `values` (T, R), by time and robot."""

    unit: str
    meaning: str
    values: NDArray[np.generic]


def series(config: SoakConfig, shards: Sequence[ShardResult]) -> bytes:
    """Return the file's contents, which depend on settings and results only, not on time or number of starts.

    Robots are numbered as in report.json. Rows are in the order of robots, then of time; robots of an interrupted
    shard have fewer.
    """
    firsts = np.cumsum([0, *(shard.counts.robots for shard in shards)])
    tables = (columns(config, shard, int(first)) for shard, first in zip(shards, firsts, strict=False))
    names = columns(config, shards[0], 0)
    schema = Schema([Field(name, _type(column), nullable=False) for name, column in names.items()])
    reader = RecordBatchReader.from_batches(schema, (_batch(table, schema) for table in tables))
    file = BytesIO()
    write_parquet(
        reader, file, compression="zstd(3)", key_value_metadata={METADATA: _metadata(config, names)}
    )
    return file.getvalue()


def columns(config: SoakConfig, shard: ShardResult, first: int) -> dict[str, Column]:
    """Return the columns of one shard, whose first robot is `first`, by name."""
    samples, robots = shard.running.shape
    hours, ones = config.spec.dt / 3600, np.ones((samples, robots), dtype=np.int64)
    ticks = config.sample_ticks * np.arange(samples)[:, None]
    return {
        "robot": Column("", "number of the robot and its draw", ones * (first + np.arange(robots))),
        "time_h": Column("h", "simulated time since the start", ones * ticks * hours),
        "running_h": Column("h", "operating time so far", shard.running * hours),
        "goals_attempted": Column("", "goals so far whose time is over", shard.attempted),
        "goals_reached": Column("", "goals reached so far, by ground truth", shard.reached),
        "stops": Column("", "stops so far", shard.stops),
        "latches": Column("", "power losses so far, each until the operator arms the robot", shard.latches),
        **dict(_events(shard)),
        **dict(_joints(config.spec.joint_names, shard)),
    }


def _events(shard: ShardResult) -> Iterator[tuple[str, Column]]:
    for k, monitor in enumerate(MONITORS):
        kind = "hard" if monitor.hard else "soft"
        meaning = f"{kind} events so far, all joints together: {monitor.meaning}"
        yield f"events_{monitor.name}", Column("", meaning, shard.events[..., k])


def _joints(names: Sequence[str], shard: ShardResult) -> Iterator[tuple[str, Column]]:
    unknown = "; NaN once the simulation diverged"
    for j, name in enumerate(names):
        yield f"winding_{name}_c", Column("°C", f"true winding temperature{unknown}", shard.winding_c[..., j])
        meaning = f"share of its current that a working motor could not draw because of its heat{unknown}"
        yield f"folded_back_{name}", Column("1", meaning, shard.folded_back[..., j])
        for k, (title, unit, wear) in enumerate(WORN):
            yield title.format(name), Column(unit, f"{wear}{unknown}", shard.worn[:, k, :, j])


def _type(column: Column) -> DataType:
    return DataType.int64() if column.values.dtype.kind == "i" else DataType.float64()


def _batch(table: Mapping[str, Column], schema: Schema) -> RecordBatch:
    """Rows of all robots, one after the other."""
    arrays = [
        Array.from_numpy(np.ascontiguousarray(column.values.T.reshape(-1))) for column in table.values()
    ]
    return RecordBatch.from_arrays(arrays, schema=schema)


def _metadata(config: SoakConfig, names: Mapping[str, Column]) -> str:
    metadata = {
        "format": FORMAT,
        "seed": config.seed,
        "robots": config.robots,
        "hours": config.hours,
        "sample_s": config.sample_ticks * config.spec.dt,
        "robot_digest": config.spec.digest,
        "draws_digest": config.distributions.digest,
        "policy_digest": config.policy.digest,
        "code_digest": code_digest(),
        "columns": {name: {"unit": column.unit, "meaning": column.meaning} for name, column in names.items()},
    }
    return json.dumps(metadata, ensure_ascii=False)
