import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deploy.reasons import AT_ONCE, LATCHING, REASONS, Reason, describe
from deploy.safety.supervisor import Supervisor
from deploy.state import Mode

DT, ARMING, HOLD = 0.01, 3, 4
SOFT, HARD, FALL = int(Reason.STALE), int(Reason.LOST), int(Reason.FALLEN)
YES, NO = np.array([True]), np.array([False])


def one(mode=Mode.DISARMED, reason=0, since=0):
    supervisor = Supervisor(1, DT, arming_s=ARMING * DT, hold_s=HOLD * DT)
    supervisor.mode[0], supervisor.reason[0], supervisor.since[0] = mode, reason, since
    return supervisor


def after(supervisor, reason=0, at_rest=True, taken_over=True):
    obey = supervisor.step(np.array([reason]), np.array([at_rest]), np.array([at_rest and taken_over]))
    return Mode(supervisor.mode[0]), bool(obey[0])


@pytest.mark.parametrize(
    ("mode", "held", "since", "reason", "at_rest", "expected", "obeys"),
    [
        ("DISARMED", 0, 99, 0, True, "DISARMED", True),
        ("DISARMED", 0, 99, HARD, True, "DISARMED", True),
        ("ARMING", 0, 0, 0, True, "ARMING", True),
        ("ARMING", 0, ARMING - 1, 0, True, "RUNNING", True),
        ("ARMING", 0, ARMING - 1, SOFT, True, "STOPPING", True),
        ("ARMING", 0, 0, HARD, True, "STOPPING", True),
        ("RUNNING", 0, 99, 0, False, "RUNNING", True),
        ("RUNNING", 0, 99, 0, True, "RUNNING", True),
        ("RUNNING", 0, 99, SOFT, False, "STOPPING", False),
        ("RUNNING", 0, 99, HARD, False, "STOPPING", False),
        ("RUNNING", 0, 99, SOFT, True, "STOPPING", False),
        ("STOPPING", SOFT, 99, 0, False, "STOPPING", True),
        ("STOPPING", SOFT, 99, SOFT, False, "STOPPING", True),
        ("STOPPING", SOFT, 99, 0, True, "HOLDING", True),
        ("STOPPING", HARD, 99, 0, False, "STOPPING", True),
        ("STOPPING", HARD, 99, 0, True, "LATCHED", True),
        ("STOPPING", SOFT | HARD, 99, 0, True, "LATCHED", True),
        ("HOLDING", SOFT, 0, 0, True, "HOLDING", True),
        ("HOLDING", SOFT, HOLD - 1, 0, True, "RUNNING", True),
        ("HOLDING", SOFT, HOLD - 1, SOFT, True, "HOLDING", True),
        ("HOLDING", HARD, HOLD - 1, 0, True, "LATCHED", True),
        ("LATCHED", HARD, 99, 0, True, "LATCHED", True),
        ("LATCHED", HARD, 99, SOFT, True, "LATCHED", True),
    ],
)
def test_every_transition(mode, held, since, reason, at_rest, expected, obeys):
    assert after(one(Mode[mode], held, since), reason, at_rest) == (Mode[expected], obeys)


def test_power_is_cut_only_once_drives_have_taken_over():
    """A robot at rest whose drives are still soft may hold, and run again, but not fall into its brakes."""
    for mode in (Mode.STOPPING, Mode.HOLDING):
        supervisor = one(mode, HARD)
        assert [after(supervisor, taken_over=False)[0] for _ in range(2 * HOLD)] == [mode] * 2 * HOLD
        assert after(supervisor)[0] == Mode.LATCHED
    supervisor = one(Mode.STOPPING, SOFT)
    modes = [after(supervisor, taken_over=False)[0] for _ in range(1 + HOLD)]
    assert modes == [Mode.HOLDING] * HOLD + [Mode.RUNNING]


def test_transitions_of_a_whole_run():
    supervisor = one()
    supervisor.arm(YES)
    modes = [after(supervisor)[0] for _ in range(ARMING)]
    assert modes == [Mode.ARMING] * (ARMING - 1) + [Mode.RUNNING]
    assert after(supervisor, SOFT, at_rest=False) == (Mode.STOPPING, False)
    assert after(supervisor, SOFT, at_rest=False) == (Mode.STOPPING, True)
    assert after(supervisor, SOFT)[0] == Mode.HOLDING
    assert supervisor.reason[0] == SOFT
    assert [after(supervisor, SOFT)[0] for _ in range(20)] == [Mode.HOLDING] * 20
    modes = [after(supervisor)[0] for _ in range(HOLD)]
    assert modes == [Mode.HOLDING] * (HOLD - 1) + [Mode.RUNNING]
    assert supervisor.reason[0] == 0


def test_intermittent_reason_keeps_holding():
    supervisor = one(Mode.HOLDING, SOFT)
    for _ in range(10):
        modes = {after(supervisor)[0] for _ in range(HOLD - 1)} | {after(supervisor, SOFT)[0]}
        assert modes == {Mode.HOLDING}


@pytest.mark.parametrize("hard", [bit for bit in Reason if bit & LATCHING & ~AT_ONCE])
def test_the_higher_category_wins_whenever_it_comes(hard):
    """Before, with or after a category 2 cause, and even when it has gone again: latched, and only once at rest."""
    for order in itertools.permutations([(SOFT, False), (int(hard), False), (0, False)]):
        supervisor = one(Mode.RUNNING)
        for reason, at_rest in order:
            after(supervisor, reason, at_rest)
        seen = [after(supervisor, 0, at_rest=k > 0)[0] for k in range(3)]
        assert seen == [Mode.STOPPING, Mode.LATCHED, Mode.LATCHED]
        assert supervisor.reason[0] & int(hard)


@pytest.mark.parametrize("mode", [Mode.ARMING, Mode.RUNNING, Mode.STOPPING, Mode.HOLDING])
@pytest.mark.parametrize("at_rest", [True, False])
def test_category_0_cuts_power_at_once(mode, at_rest):
    supervisor = one(mode, SOFT)
    supervisor.since[:] = 1000
    after(supervisor, FALL | HARD, at_rest)
    assert (supervisor.mode[0], supervisor.since[0]) == (Mode.LATCHED, 0)
    assert supervisor.reason[0] == FALL | HARD | SOFT


@pytest.mark.parametrize("mode", [Mode.DISARMED, Mode.LATCHED])
def test_a_robot_without_power_keeps_its_mode_when_it_falls(mode):
    supervisor = one(mode)
    assert after(supervisor, FALL)[0] == mode
    assert supervisor.reason[0] == 0


@pytest.mark.parametrize("bit", list(Reason))
def test_category_of_every_reason(bit):
    supervisor = one(Mode.RUNNING)
    after(supervisor, int(bit), at_rest=False)
    after(supervisor, 0)
    for _ in range(HOLD + 1):
        mode = after(supervisor)[0]
    assert mode == (Mode.LATCHED if bit in LATCHING else Mode.RUNNING)


def test_reasons_are_recorded_for_the_robots_that_they_stop_alone():
    """One robot of three: the others run and have no power."""
    supervisor = Supervisor(3, DT)
    supervisor.mode[:] = Mode.RUNNING, Mode.RUNNING, Mode.DISARMED
    supervisor.step(np.array([0, SOFT, HARD]), *np.ones((2, 3), dtype=bool))
    assert supervisor.mode.tolist() == [Mode.RUNNING, Mode.STOPPING, Mode.DISARMED]
    assert supervisor.reason.tolist() == [0, SOFT, 0]


def test_latch_cuts_power_at_once_and_keeps_every_reason():
    supervisor = Supervisor(2, DT)
    supervisor.mode[:], supervisor.since[:], supervisor.reason[:] = Mode.STOPPING, 7, SOFT
    supervisor.latch(np.array([True, False]), Reason.NOT_FINITE)
    assert supervisor.mode.tolist() == [Mode.LATCHED, Mode.STOPPING]
    assert supervisor.reason.tolist() == [SOFT | int(Reason.NOT_FINITE), SOFT]
    assert supervisor.since.tolist() == [0, 7]


def test_times_by_default():
    """0.1 s of arming and 0.25 s of rest."""
    supervisor = Supervisor(1, DT)
    supervisor.arm(YES)
    assert [after(supervisor)[0] for _ in range(10)] == [Mode.ARMING] * 9 + [Mode.RUNNING]
    after(supervisor, SOFT)
    after(supervisor)
    assert [after(supervisor)[0] for _ in range(25)] == [Mode.HOLDING] * 24 + [Mode.RUNNING]


def test_category_1_while_holding_latches():
    supervisor = one(Mode.HOLDING, SOFT)
    after(supervisor, HARD)
    assert after(supervisor)[0] == Mode.LATCHED


def test_operator_latches_only_after_rest():
    supervisor = one(Mode.RUNNING)
    for _ in range(30):
        assert after(supervisor, int(Reason.OPERATOR), at_rest=False)[0] == Mode.STOPPING
        assert supervisor.powered[0]
    assert after(supervisor, int(Reason.OPERATOR))[0] == Mode.LATCHED
    assert not supervisor.powered[0]


def test_only_arming_leads_out_of_latched():
    supervisor = one(Mode.LATCHED, HARD)
    for reason, at_rest in itertools.product((0, SOFT, HARD), (True, False)):
        assert after(supervisor, reason, at_rest)[0] == Mode.LATCHED
    supervisor.arm(NO)
    assert supervisor.mode[0] == Mode.LATCHED
    supervisor.arm(YES)
    assert (supervisor.mode[0], supervisor.reason[0], supervisor.since[0]) == (Mode.ARMING, 0, 0)


@pytest.mark.parametrize("mode", ["ARMING", "RUNNING", "STOPPING", "HOLDING"])
def test_arming_what_is_powered_changes_nothing(mode):
    """Above all not the reason for which a robot is about to latch."""
    supervisor = one(Mode[mode], HARD, since=2)
    before = supervisor.save()
    supervisor.arm(YES)
    for name, array in before.items():
        np.testing.assert_array_equal(getattr(supervisor, name), array)


def test_disarm_cuts_power_in_every_mode():
    for mode in Mode:
        supervisor = one(mode)
        supervisor.disarm(NO)
        assert supervisor.mode[0] == mode
        supervisor.disarm(YES)
        assert supervisor.mode[0] == Mode.DISARMED


def check_invariants(before, reason_before, after_mode, reason, rest, obey):
    at_rest, stopped = rest
    running, refused = before == Mode.RUNNING, reason != 0
    assert obey == (not (running and refused))
    if reason & FALL and before not in (Mode.DISARMED, Mode.LATCHED):
        assert after_mode == Mode.LATCHED
        return
    if running:
        assert after_mode == (Mode.STOPPING if refused else Mode.RUNNING)
    if after_mode == Mode.RUNNING:
        assert before in (Mode.RUNNING, Mode.ARMING, Mode.HOLDING)
        assert not refused
    if after_mode == Mode.LATCHED:
        assert before in (Mode.STOPPING, Mode.HOLDING, Mode.LATCHED)
        assert before == Mode.LATCHED or stopped
        assert reason_before & int(LATCHING) or before == Mode.LATCHED
    if before in (Mode.DISARMED, Mode.LATCHED):
        assert after_mode == before
    if before == Mode.STOPPING:
        assert (after_mode == Mode.STOPPING) == (not (stopped if reason_before & LATCHING else at_rest))


@pytest.mark.slow
def test_all_short_input_sequences():
    """All 9^5 sequences of (reason, rest, end of a stop) from RUNNING keep the invariants."""
    rests = ((False, False), (True, False), (True, True))
    steps = [(reason, *rest) for reason, rest in itertools.product((0, SOFT, HARD), rests)]
    histories = np.array(list(itertools.product(range(len(steps)), repeat=5)))
    supervisor = Supervisor(len(histories), DT, arming_s=ARMING * DT, hold_s=2 * DT)
    supervisor.mode[:] = Mode.RUNNING
    hard_seen = np.zeros(len(histories), dtype=bool)
    for choice in histories.T:
        reason, at_rest, stopped = (np.array(column)[choice] for column in zip(*steps, strict=True))
        before, held = supervisor.mode.copy(), supervisor.reason.copy()
        obey = supervisor.step(reason, at_rest, stopped)
        hard_seen |= (reason == HARD) & (before != Mode.LATCHED)
        for i in range(len(histories)):
            check_invariants(
                before[i], held[i], supervisor.mode[i], reason[i], (at_rest[i], stopped[i]), obey[i]
            )
        assert not (hard_seen & (supervisor.mode == Mode.RUNNING)).any()
        off = (supervisor.mode == Mode.LATCHED) | (supervisor.mode == Mode.DISARMED)
        np.testing.assert_array_equal(supervisor.powered, ~off)
        np.testing.assert_array_equal(supervisor.stopping, supervisor.mode != Mode.RUNNING)


@settings(max_examples=100)
@given(
    history=st.lists(
        st.tuples(
            st.sampled_from([0, 0, SOFT, HARD, SOFT | HARD, FALL]),
            st.booleans(),
            st.booleans(),
            st.sampled_from("   ad"),
        ),
        max_size=60,
    )
)
def test_long_input_sequences_with_an_operator(history):
    supervisor = one()
    for reason, at_rest, taken_over, key in history:
        if key == "a":
            supervisor.arm(YES)
        if key == "d":
            supervisor.disarm(YES)
        before, held = Mode(supervisor.mode[0]), int(supervisor.reason[0])
        mode, obey = after(supervisor, reason, at_rest, taken_over)
        check_invariants(before, held, mode, reason, (at_rest, at_rest and taken_over), obey)


def test_robots_do_not_touch_each_other():
    rng, many, alone = np.random.default_rng(0), Supervisor(8, DT), [Supervisor(1, DT) for _ in range(8)]
    many.arm(np.ones(8, dtype=bool))
    for supervisor in alone:
        supervisor.arm(YES)
    for _ in range(300):
        reason, rest = rng.choice([0, 0, 0, 0, SOFT, HARD], 8), rng.random(8) < 0.7
        obey = many.step(reason, rest, rest)
        for i, supervisor in enumerate(alone):
            one_obeys = supervisor.step(reason[i : i + 1], *[rest[i : i + 1]] * 2)
            assert (supervisor.mode[0], supervisor.reason[0], one_obeys[0]) == (
                many.mode[i],
                many.reason[i],
                obey[i],
            )


def test_saved_and_restored():
    rng, first, second = np.random.default_rng(1), Supervisor(4, DT), Supervisor(4, DT)
    first.arm(np.ones(4, dtype=bool))
    for k in range(100):
        reason, rest = rng.choice([0, 0, 0, SOFT], 4), rng.random(4) < 0.7
        first.step(reason, rest, rest)
        if k == 40:
            second.restore(first.save())
        elif k > 40:
            second.step(reason, rest, rest)
            np.testing.assert_array_equal(second.mode, first.mode)
            np.testing.assert_array_equal(second.since, first.since)


def test_every_reason_has_a_description():
    assert set(REASONS) == set(Reason)
    assert describe(0) == "no reason"
    assert (
        describe(int(Reason.HEAT | Reason.LOST))
        == f"{REASONS[Reason.HEAT].text}; {REASONS[Reason.LOST].text}"
    )
