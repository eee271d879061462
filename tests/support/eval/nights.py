import numpy as np

from eval.faults.schedule import FaultSettings
from eval.history.soak_record import Run, Settings, SoakRecord
from eval.judge.monitors import MONITORS
from eval.statistics.per_draw_counts import PerDrawCounts

HOUR = 720_000
HARD = [monitor.name for monitor in MONITORS if monitor.hard]
SETTINGS = Settings(
    command="soak-test",
    robot="arm6",
    robot_digest="a1",
    draws_digest="d1",
    limits_digest="f1",
    policy="arm.onnx",
    policy_digest="b1",
    code_digest="c1",
    faults=None,
    budget="budget.toml",
    seed=1,
    hours=8.0,
    robots=16,
    shard_width=8,
    workers=2,
    versions={"numpy": "2.4"},
)
OTHER = {
    "robot": {"robot": "planar3"},
    **{f"{key}_digest": {f"{key}_digest": "z9"} for key in ("robot", "draws", "limits", "policy", "code")},
    "hours": {"hours": 8.5},
    "faults": {"faults": FaultSettings(coverage=0.95, cycle_s=20.0, operator_s=5.0)},
    "shard_width": {"shard_width": 16},
    "numpy": {"versions": {"numpy": "2.5"}},
}
"""By the key of the identity, settings that change it and nothing else."""


def tallied(seed, draws=16, rate=0.5):
    """8 h of each draw, less a minute for each stop; events and stops by chance."""
    rng = np.random.default_rng(seed)
    stops = rng.poisson(0.5, draws)
    hard = {name: tuple(rng.poisson(rate / len(HARD), draws).tolist()) for name in HARD}
    due = np.full(draws, 7199)
    return PerDrawCounts(
        dt=0.005,
        ticks=(8 * HOUR,) * draws,
        invalid=(0,) * draws,
        running=tuple((8 * HOUR - 12_000 * stops).tolist()),
        stops=tuple(stops.tolist()),
        due=tuple(due.tolist()),
        reached=tuple(rng.binomial(due, 0.98).tolist()),
        hard=hard,
        hottest_c=tuple(rng.uniform(60, 90, draws).round(2).tolist()),
    )


def night(seed=1, *, started="2026-01-02T22:00:00+01:00", draws=16, rate=0.5, verdict="passed", **changes):
    settings = SETTINGS.model_copy(update={"seed": seed, "robots": draws, **changes})
    found = SoakRecord(
        format=2,
        verdict=verdict,
        statement="What was found.",
        settings=settings,
        run=Run(started=started, wall_s=60.0, hours=8.0, resumed_hours=0.0, interrupted=False),
        per_draw_counts=tallied(seed, draws, rate),
    )
    return found.model_copy(update={"results_digest": found.sealed()})


def named(*nights):
    return {f"night-{k}.json": each for k, each in enumerate(nights)}


LATER = "2026-01-03T22:00:00+01:00"
