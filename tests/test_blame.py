"""Which joint a reason is about."""

import numpy as np
import pytest
from test_spec import SPEC

pytest.importorskip("mujoco")

from test_runtime import built, heard, running

from deploy.blame import blame
from deploy.estimator import DIVERGED
from deploy.load import LOOKS
from deploy.state import Reason
from deploy.supervisor import WORDS

pytestmark = pytest.mark.usefixtures("quick_goals")

WRIST = SPEC.joint_names.index("wrist_2")


@pytest.fixture
def runtime():
    return running(2)


def beyond(runtime):
    runtime.state.q[0, WRIST] = SPEC.joints[WRIST].q_max + 0.01


def astray(runtime):
    runtime.state.q[0, WRIST] = runtime.setpoint.q[0, WRIST] + 1.1 * SPEC.margins.tracking_rad


def hot(runtime):
    runtime.state.temperature[0, WRIST] = 500.0


def lost(runtime):
    runtime.estimator.nis[0, WRIST] = DIVERGED + 1


def hanging(runtime):
    runtime.estimator.same[0] = 10**6  # as at rest: nobody was sent away
    runtime.estimator.moved[0] = runtime.estimator.sent[0, runtime.estimator._place, : SPEC.n]
    runtime.estimator.moved[0, WRIST] += 0.1


def leaning(runtime):
    runtime.estimator.load.many[0, WRIST] = LOOKS


def moving(runtime):
    runtime.estimator.ed[0, WRIST] = 10.0


@pytest.mark.parametrize(
    ("befall", "reason"),
    [
        (beyond, Reason.OUTSIDE),
        (astray, Reason.TRACKING),
        (hot, Reason.HEAT),
        (lost, Reason.DIVERGED),
        (hanging, Reason.STUCK),
        (leaning, Reason.LOAD),
        (moving, Reason.MOVING),
    ],
)
def test_a_reason_names_its_joint(runtime, befall, reason):
    assert blame(runtime, int(reason)) == WORDS[reason]
    befall(runtime)
    assert blame(runtime, int(reason)) == f"{WORDS[reason]} (wrist_2)"


@pytest.mark.parametrize("reason", list(Reason))
def test_every_reason_has_words(runtime, reason):
    assert blame(runtime, int(reason)).startswith(WORDS[reason])


def test_several_are_told_one_after_the_other(runtime):
    beyond(runtime)
    said = blame(runtime, int(Reason.STALE | Reason.OUTSIDE))
    assert said == "samples are missing; a joint is outside its working range (wrist_2)"


def test_nothing_is_known_before_the_first_packet():
    runtime = built(1)
    runtime.tick()
    assert blame(runtime, int(Reason.HEAT | Reason.OUTSIDE)).count("(") == 0


def test_who_is_refused_is_told_which_joint_moves():
    runtime = built(1)
    heard(runtime)
    runtime.estimator.ed[0, WRIST] = 1.0
    refused = runtime.arm(np.ones(1, dtype=bool))
    assert blame(runtime, int(refused[0])) == "a joint moves while the drives are off (wrist_2)"
