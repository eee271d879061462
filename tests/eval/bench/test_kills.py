import shutil

import numpy as np
import pytest

from support.arm6 import SPEC

pytest.importorskip("mujoco")

from eval.bench.kills import KINDS, POLL_S, SoakProcess

HOURS = 0.0003


@pytest.mark.skipif(shutil.which("ps") is None, reason="needs ps")
@pytest.mark.slow
def test_killed_soak_gives_the_same_results_and_leaves_nothing(arm_policy, tmp_path):
    """Its parent, a worker and all of it, each as soon as there are workers."""

    def start(folder):
        return SoakProcess(SPEC, arm_policy, HOURS, tmp_path / folder)

    whole, soak, rng = start("whole"), start("killed"), np.random.default_rng(0)
    for kill in KINDS:
        while not soak.others("spawn_main"):
            assert not soak.ends_within(POLL_S)
        kill(soak, rng)
        if soak.ends_within(0):
            assert soak.left_behind() == []
            soak = start("killed")
    for process in (whole, soak):
        process.ends_within(None)
        assert process.left_behind() == []
    assert soak.results() == whole.results()
    assert soak.results()["exit code"] == 1
