"""The search on functions in the place of robots: what it finds, and what it depends on."""

from itertools import islice

import numpy as np
import pytest

from eval.attack.adversaries import ADVERSARIES, GAINS, OF_MANY, pushed_arms
from eval.attack.archive import EXEMPT, Archive
from eval.attack.arena import Outcome
from eval.attack.candidate import Block
from eval.attack.search import GENERATIONS, Search
from eval.shard.job import WIDTH
from robots.motors.control_mode import ControlMode
from support.arm6 import SPEC

MODE = ControlMode.POSITION
PUSHED = pushed_arms(MODE, gains=False)
NAMES = [monitor.name for monitor in Archive(SPEC, MODE).monitors]
EASE = np.linspace(0.0, 0.2, WIDTH)
"""By how much robots differ under the same policy."""


def outcome(**ratios):
    """Ratios of some monitors; the others stay at 0.5."""
    still = {name: np.full(WIDTH, 0.5) for name in NAMES}
    return Outcome(still | ratios, np.zeros(WIDTH, dtype=bool))


def hill(blocks):
    """Speed is highest where all pushes are 1.2, on robots that differ; only three adversaries push."""

    def ratio(row):
        return np.exp(-np.mean((np.array(row.get("push", [-2.0])) - 1.2) ** 2))

    return [outcome(velocity=np.array([ratio(row) for row in block.rows]) - EASE) for block in blocks]


def searched(generations, evaluate=hill, **options):
    search = Search(SPEC, MODE, evaluate, **{"seed": 7, "pushed_arms": (), **options})
    for _ in islice(search.run(), generations):
        pass
    return search


CYCLE = GENERATIONS + 2


def test_angles_are_compared_where_the_ratios_of_all_joints_are_the_same():
    """At the soft limits: beside joints of wide ranges, the ratio to the end of a narrow one is never the highest."""

    def narrow(blocks):
        return [outcome(position_soft=each.worst["velocity"]) for each in hill(blocks)]

    search = searched(1 + 4 * CYCLE, narrow, target="position_hard")
    assert search.archive.worst["position_soft"].ratio > 0.97


def test_search_climbs_a_hill_whatever_adversary_is_on_it():
    library = searched(1, target="velocity").archive.worst["velocity"].ratio
    search = searched(1 + 4 * CYCLE, target="velocity")
    assert search.archive.worst["velocity"].ratio > max(0.97, library)
    assert search.archive.worst["velocity"].candidate.adversary in (
        "anti_damping",
        "bang_bang",
        "swing",
        "push",
    )


def test_robots_that_differ_do_not_mislead_the_search():
    """The worst is found on the worst robot, although each candidate was tried on another."""
    search = searched(1 + 4 * CYCLE, target="velocity")
    best = search.archive.worst["velocity"]
    assert (
        best.ratio == hill([Block("push", (best.candidate.weights,) * WIDTH, 0)])[0].worst["velocity"].max()
    )


def test_results_depend_on_the_seed_and_not_on_the_order_in_which_blocks_are_tried():
    def backwards(blocks):
        np.random.default_rng().random()
        return hill(blocks[::-1])[::-1]

    first, second = searched(2 * CYCLE), searched(2 * CYCLE, backwards)
    assert first.archive.worst == second.archive.worst
    assert first.archive.worst != searched(2 * CYCLE, seed=8).archive.worst


def test_every_generation_has_all_robots_busy_and_every_cycle_other_robots():
    seen = []

    def evaluate(blocks):
        seen.append(blocks)
        return hill(blocks)

    search = searched(1 + 2 * CYCLE, evaluate)
    assert {len(block.rows) for blocks in seen for block in blocks} == {WIDTH}
    assert [{block.seed for block in blocks} for blocks in seen] == [{7}] + [{8}] * CYCLE + [{9}] * CYCLE
    assert search.archive.trials == WIDTH * sum(map(len, seen))


def steps(blocks):
    """Torque is highest where all steps are -1.2, from that of the others on."""

    def ratio(row):
        return 0.5 + np.exp(-np.mean((np.array(row["step"]) + 1.2) ** 2)) if "step" in row else 0.5

    return [outcome(torque=np.array([ratio(row) for row in block.rows])) for block in blocks]


def test_searches_of_pushed_arms_go_on_from_cycle_to_cycle():
    few, many = (
        searched(1 + cycles * CYCLE, steps, pushed_arms=PUSHED).archive.worst["torque"] for cycles in (1, 12)
    )
    assert few.candidate.adversary == many.candidate.adversary == "loaded_arm"
    assert many.ratio > max(1.49, few.ratio + 0.02)


def test_pushed_arms_have_their_targets_and_begin_again_on_others_once_they_have_converged():
    """On a plain, each search ends at once."""
    seen = []

    def plain(blocks):
        seen.append([(block.adversary, block.seed) for block in blocks if block.adversary not in OF_MANY])
        return [outcome() for _ in blocks]

    search = searched(40, plain, pushed_arms=PUSHED)
    targets = [monitor for each in ADVERSARIES.values() for monitor in each.targets]
    assert len(targets) == len(seen[0]) == len({*seen[0]})
    assert {len(each) for each in seen} == {len(targets)}
    assert len({seed for each in seen for _, seed in each}) > len(targets)
    one = Search(SPEC, MODE, plain, seed=7, target="workspace", pushed_arms=PUSHED)
    next(one.run())
    assert [name for name, _ in seen[-1]] == ["hot_arm"]
    assert search.archive.worst_of_many["torque"].candidate.adversary in OF_MANY


@pytest.mark.parametrize(("mode", "gains"), [(MODE, True), (ControlMode.TORQUE, False)])
def test_drive_gains_without_effect_are_not_searched(mode, gains):
    seen = []

    def plain(blocks):
        seen.extend(row for block in blocks if block.adversary not in OF_MANY for row in block.rows)
        return [outcome() for _ in blocks]

    arms = pushed_arms(mode, gains=gains)
    searched(4, plain, pushed_arms=arms)
    first = ADVERSARIES["thrown_tool"].first(SPEC.n)
    assert all(row.keys() == first.keys() for row in seen)
    for name in GAINS:
        assert {row[name] for row in seen} == {first[name]}
    assert (len({row["damping"] for row in seen}) > 1) == (mode is ControlMode.TORQUE)
    assert len({row["force_s"] for row in seen}) > 1


def test_only_hard_monitors_are_searched_and_what_the_policy_says_itself_is_none():
    hard = Search(SPEC, MODE, hill, seed=7, pushed_arms=PUSHED).targets
    assert not {*hard} & {*EXEMPT}
    assert {"velocity", "torque", "tool_speed", "position_hard"} <= {*hard}
    assert "power" not in hard


def test_archive_keeps_the_first_of_equals_and_counts_what_diverged():
    archive, row = Archive(SPEC, MODE), {"push": (0.0,)}
    ratios = np.zeros(WIDTH)
    ratios[[3, 5]] = 1.5
    bad = outcome(torque=ratios)._replace(diverged=np.arange(WIDTH) < 2)
    archive.add(Block("push", tuple(row | {"reach": (float(k),)} for k in range(WIDTH)), 1), bad)
    archive.add(Block("chirp", (row,) * WIDTH, 2), bad)
    assert archive.worst["torque"].ratio == 1.5
    assert archive.worst["torque"].candidate == ("push", row | {"reach": (3.0,)}, 1)
    assert (archive.hits, archive.diverged, archive.trials) == (("torque",), 4, 2 * WIDTH)
    assert archive.moved("torque")
    assert not archive.moved("jerk")


@pytest.mark.parametrize("worst", [np.inf, 3.0])
def test_infinite_ratios_do_not_stop_a_search(worst):
    def evaluate(blocks):
        return [outcome(velocity=np.full(WIDTH, worst)) for _ in blocks]

    assert searched(1 + CYCLE, evaluate, target="velocity").archive.hits == ("velocity",)
