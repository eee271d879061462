"""What the report says of faults on schedule."""

from dataclasses import replace

import numpy as np
import pytest

from deploy.policy.compatibility import sensors_read
from eval.faults.catalogue import catalogue, not_injected
from eval.faults.fault_class import StopCategory
from eval.faults.fault_response import FaultResponses
from eval.faults.schedule import FaultSettings
from eval.judge.monitors import NAMES
from eval.report.build import build
from eval.report.report_files import junit
from eval.report.schema.report_data import Report
from eval.report.sections.faults import fault_table
from eval.statistics.budget import load_budget
from support.arm6 import SPEC
from support.contracts import arm_contract
from support.eval.reports import Page, rendered, soak

READ = sensors_read(arm_contract(), SPEC)
CLASSES, ROBOTS = catalogue(SPEC, READ), 60


def every_class_handled():
    """One of each class for each of 60 robots: all hold after 0.1 s and rest after 0.2 to 0.495 s."""
    shape = ROBOTS, len(CLASSES)
    kind = np.tile(np.arange(len(CLASSES)), (ROBOTS, 1))
    answer = np.array([min(each.answer, StopCategory.CATEGORY_2) for each in CLASSES])[kind]
    left, rest = (
        np.where(answer == StopCategory.CATEGORY_2, 20, -1),
        np.where(answer == StopCategory.CATEGORY_2, 40, -1),
    )
    rest[:, :] = np.where(rest > 0, rest + np.arange(ROBOTS)[:, None], -1)
    whole = {"began": 720, "complete": 400, "resumed": 30, "channel": 1, "violated": 0}
    error, ratio = np.full(shape, 0.01), np.full(shape, 0.8)
    filled = {name: np.full(shape, value) for name, value in whole.items()}
    filled |= {"class_index": kind, "answer": answer, "tracking_error": error, "limit_ratio": ratio}
    pair = np.full((*shape, 2), -1)
    return FaultResponses(stopped=left, rest=rest, pair=pair, **filled)


def report(found):
    table = fault_table(SPEC, READ, FaultSettings(coverage=0.95, cycle_s=20.0, operator_s=5.0), found)
    return build(replace(soak(), faults=table), load_budget())


def test_enough_handled_faults_pass():
    found = report(every_class_handled())
    assert found.verdict == "passed"
    assert found.budget[0].name == "fault_coverage"
    assert found.budget[0].found == pytest.approx(0.05 ** (1 / ROBOTS))
    first = f"{CLASSES[0].name}, 60 of 60 handled"
    assert found.budget[0].about == f"lowest bound: {first}"
    row = found.faults.rows[0]
    assert (row.stopped.median_s, row.at_rest.worst_s) == (0.1, pytest.approx((40 + 59) * SPEC.dt))
    assert (row.resumed, row.deviation_rad, row.load) == (60, 0.01, 0.8)
    assert Report.model_validate_json(found.model_dump_json()) == found


def test_unhandled_fault_fails_and_is_named():
    told = every_class_handled()
    told.violated[3, -1] = 1 << NAMES.index("torque")
    told.tracking_error[3, -1] = np.nan
    found = report(told)
    assert [line.name for line in found.budget if not line.passed] == ["fault_coverage"]
    about = f"lowest bound: {CLASSES[-1].name}, 59 of 60 handled; with 1 unhandled, 95 % needs 93 injections"
    assert found.budget[0].about == about
    assert about in "".join(Page(rendered(found)).words)
    assert f"allowed at least 0.95 ({about})" in junit(found)
    assert (found.faults.rows[-1].handled, found.faults.rows[-1].violations) == (59, {"torque": 1})
    assert found.faults.rows[-1].deviation_rad is None
    (fault,) = found.faults.unhandled
    assert (fault.fault, fault.robot, fault.start_h, fault.violations) == (
        CLASSES[-1].name,
        3,
        0.001,
        ("torque",),
    )


def test_a_class_that_was_not_injected_is_no_failure_of_the_robot():
    told = every_class_handled()
    told.complete[:, 0] = -1
    page = rendered(report(told))
    words = " ".join("".join(Page(page).words).split())
    assert words.count("not injected") == 1
    assert words.count("60 of 60") == len(CLASSES) - 1
    about = f"lowest bound: {CLASSES[0].name}, 0 of 0 handled; 95 % needs 59 injections"
    assert about in words
    faults = page[page.index("Injected faults") : page.index("Limitations of this soak")]
    assert 'class="hit' not in faults


def test_a_class_that_the_profile_leaves_out_has_no_row():
    names = tuple(each.name for each in CLASSES[:3])
    settings = FaultSettings(coverage=0.95, cycle_s=20.0, operator_s=5.0, classes=names)
    table = fault_table(SPEC, READ, settings, every_class_handled())
    assert tuple(f"{row.where} {row.what}" for row in table.rows) == names
    left_out = len(CLASSES) - 3
    assert table.not_injected[0] == f"{left_out} of {len(CLASSES)} classes, which the profile leaves out."


@pytest.mark.slow
def test_the_page_shows_every_class_and_what_was_not_injected():
    told = every_class_handled()
    told.violated[3, -1] = 1 << NAMES.index("torque")
    words = " ".join("".join(Page(rendered(report(told))).words).split())
    for each in CLASSES:
        assert each.name in words
    assert "Failures of the sensor force (7 classes): not read" in words
    for sentence in not_injected(SPEC, READ):
        assert sentence in words
    assert "0.10 / 0.10" in words
    assert "category 1category 2 60" in words
    assert "The first 1 unhandled faults" in words
    assert "Injected faults" not in rendered(build(soak(), load_budget()))
