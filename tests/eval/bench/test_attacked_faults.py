"""The bench of faults under adversaries, for one class."""

import pytest

pytest.importorskip("mujoco")

from eval.attack import arena, search
from eval.bench.attacked_faults import row, worst_of
from support.planar import PLANAR3


@pytest.mark.slow
def test_worst_monitors_of_a_fault_come_first(monkeypatch):
    monkeypatch.setattr(arena, "FAULTY_EPISODE_S", 5.5)
    monkeypatch.setattr(search, "OF_MANY", ("bang_bang",))
    worst = worst_of(PLANAR3, "encoder slips")
    ratios = [ratio for _, ratio in worst]
    assert ratios == sorted(ratios, reverse=True)
    assert dict(worst)["torque"] > 1.0
    assert row("encoder slips", worst).startswith("| encoder slips | `")


def test_a_row_shows_what_is_beyond_its_limit_or_the_worst():
    assert row("a", [("torque", 1.2), ("jerk", 0.9999), ("velocity", 0.9)]) == "| a | `torque` 1.20 |"
    assert row("a", [("jerk", 0.9999), ("velocity", 0.934), ("torque", 0.5)]) == "| a | `velocity` 0.93 |"
    assert row("a", [("jerk", 1.2), ("velocity", 0.9)]) == "| a | `jerk` 1.20 |"
