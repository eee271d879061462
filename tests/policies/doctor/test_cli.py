"""policy-check as a command."""

import pytest

pytest.importorskip("mujoco")

from policies.doctor.cli import cli


def test_a_policy_is_tried_in_a_separate_process_first(arm_policy, crashing_trial, call):
    code, said, complaint = call(cli, arm_policy)
    assert (code, said, complaint) == (2, "", f"error: {arm_policy}: {crashing_trial}\n")
