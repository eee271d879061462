"""The attacker itself: without a guard its search finds the event that the guard prevents, and with it none."""

from itertools import islice

import pytest

pytest.importorskip("mujoco")

import eval.attack.arena as module
from eval.attack.adversaries import OF_MANY
from eval.attack.arena import Arena, Setting
from eval.attack.guards import find_guard
from eval.attack.search import Search
from eval.mutants.situation import keep_guards
from eval.shard.job import WIDTH
from robots.motors.control_mode import ControlMode
from support.arm6 import SPEC

MODE, SEED = ControlMode.POSITION, 9
SHORT_S, LONG_S = 1.1, 3.0
"""s of a trial: 0.8 of operation, and 2.7, in which each of the events below is found."""
TRIALS = WIDTH * len(OF_MANY)
"""The library: what every search tries first."""
GENERATIONS = 4
"""Of a search for one event, the library included."""
JERK = ("planner: jerk × 1.2", "runtime: zero velocity after a refused setpoint")
GUARDS = (
    "safety: tool speed, off",
    "safety: workspace, off",
    "safety: collision, off",
    "safety: the stop's first step",
)


class HardEventError(Exception):
    """End of a search whose aim is one event."""


def attacked(without="", seconds=LONG_S, target=None):
    """Return what a search found, each policy tried for some seconds: the library, or more for a target's event.

    Raises:
        HardEventError: an event of the target was found.
    """

    def try_block(block):
        outcome = arena.try_block(block)
        if target and outcome.worst[target].max() > 1.0:
            raise HardEventError
        return outcome

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "EPISODE_S", seconds)
        arena = Arena(Setting(robot=SPEC.folder, mode=MODE, without=without), SEED)
        search = Search(
            SPEC,
            MODE,
            lambda blocks: [try_block(block) for block in blocks],
            seed=SEED,
            target=target or "",
            pushed_arms=(),
        )
        generations = GENERATIONS if target else 1
        assert len(list(islice(search.run(), generations))) == generations
    assert search.archive.trials >= TRIALS
    return search.archive


@pytest.fixture(scope="module")
def guarded_shortly():
    return attacked(seconds=SHORT_S)


@pytest.fixture(scope="module")
def guarded():
    return attacked()


def check(part, guarded, seconds=LONG_S):
    mutant = find_guard(part)
    assert mutant.situation.prepare is keep_guards, "other guards would be removed as well"
    with pytest.raises(HardEventError):
        attacked(part, seconds, mutant.monitor)
    assert guarded.worst[mutant.monitor].ratio <= 1.0


@pytest.mark.parametrize("part", JERK)
def test_jerk_is_found_at_once_without_its_guard_and_not_with_it(part, guarded_shortly):
    check(part, guarded_shortly, SHORT_S)


@pytest.mark.slow
def test_nothing_is_found_while_all_guards_are_there(guarded):
    assert (guarded.hits, guarded.diverged) == ((), 0)


@pytest.mark.slow
@pytest.mark.parametrize("part", GUARDS)
def test_event_is_found_without_its_guard_and_not_with_it(part, guarded):
    check(part, guarded)
