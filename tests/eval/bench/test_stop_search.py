"""The search for stops whose motion between the checked moments is worst, for a few generations."""

import numpy as np
import pytest

pytest.importorskip("mujoco")

from eval.bench.stop_search import StopSearch
from support.arm6 import SPEC
from support.deploy.safety import FASTER_IN_ITS_STOP, point


def test_a_whole_stop_has_the_checked_moments_and_more():
    search, x = StopSearch(SPEC, 16), np.random.default_rng(0).random((16, 3 * SPEC.n))
    wholes = []
    for row, quantity in enumerate(search.quantities):
        checked, whole, refused = search.run(search.start(x), quantity)
        assert (whole >= checked[row]).all()
        wholes.append(whole)
    gains = (np.array(wholes) > checked + 1e-4).any(axis=1)
    assert gains[[search.quantities.index(each) for each in ("torque", "tool speed", "gap")]].all()
    bounds = np.array(list(search.bounds.values()))
    assert refused[(checked > bounds[:, None] + 1e-6).any(axis=0)].all()


def test_a_tool_that_gains_speed_in_its_stop_is_seen():
    search = StopSearch(SPEC, 1)
    checked, whole, refused = search.run(point(*FASTER_IN_ITS_STOP), "tool speed")
    assert refused.all()
    row = search.quantities.index("tool speed")
    assert whole[0] >= checked[row, 0] > search.bounds["tool speed"]


def test_the_search_finds_more_than_its_first_guesses():
    search = StopSearch(SPEC, 32)
    few, more = (search.worst("tool speed", generations, seed=3) for generations in (1, 12))
    assert 0.3 < few < more < 1.0
