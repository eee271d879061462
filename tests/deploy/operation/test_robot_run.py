import signal
from contextlib import suppress
from functools import partial

import numpy as np
import pytest

from deploy.backends.sim.backend import SimBackend
from deploy.backends.sim.robot import SimRobot
from deploy.operation.interrupts import FAULTS, SIGNALS, WRITE_ERRORS, Interrupts, handled
from deploy.operation.loop_timing import LoopTiming, WallClock
from deploy.operation.robot_run import ARM_AFTER_S, Ending, RobotRun
from deploy.policy.policy import Policy
from deploy.reasons import Reason
from deploy.runtime import Runtime
from deploy.state import Mode
from deploy.telemetry.recorder import Recorder
from robots.randomness import robot_seed
from robots.spec import load_robot
from support.deploy.fake_time import FakeTime

SPEC = load_robot("arm6")


class Watched(SimRobot):
    """A simulated robot that remembers what it was told."""

    def __init__(self, *args):
        super().__init__(*args)
        self.sent, self.cut = [], 0

    def write(self, command):
        powered = bool(command.powered[0])
        self.sent.append((powered, np.concatenate((command.q[0], command.qd[0], command.tau[0]))))
        super().write(command)

    def stop(self, ids):
        self.cut += 1
        super().stop(ids)


class Bench:
    """A whole run but for the wall's time; `at` maps a tick to what happens while waiting for it."""

    def __init__(self, folder, policy, *, duration=1.0, at=None):
        seeds = [robot_seed(7, 0)]
        self.time, self.at, self.slots = FakeTime(), at or {}, 0
        self.robot, self.policy = Watched(SPEC, seeds), Policy.load(policy, SPEC)
        self.runtime = Runtime(SPEC, self.policy.contract, self.robot, seeds, self.policy)
        SimBackend().attach(self.robot, self.runtime)
        clock = WallClock(SPEC.dt, now=self.time.now, sleep=self.sleep)
        self.timing = LoopTiming(clock, SPEC.rates.control_hz, now=self.time.now)
        self.recorder = Recorder(folder, self.runtime, start_ns=0, about={})
        self.interrupts = Interrupts()
        self.interrupts.running = True
        self.run = RobotRun(
            self.runtime, self.timing, self.recorder, interrupts=self.interrupts, duration=duration
        )

    def sleep(self, seconds):
        self.time.sleep(seconds)
        self.slots += 1
        self.at.get(self.slots, lambda: None)()

    def live(self):
        try:
            with handled(self.interrupts):
                return self.run.run()
        finally:
            self.recorder.close()

    def planned(self):
        """(T, 3 n): q, qd and torque of every command that was sent with the drives on."""
        return np.array([numbers for powered, numbers in self.robot.sent if powered])


@pytest.fixture
def bench(tmp_path, arm_policy):
    return lambda **kwargs: Bench(tmp_path, arm_policy, **kwargs)


def comes_to_rest(b):
    """The last commands were a controlled stop: within limits, and at rest before power went."""
    n, sent = SPEC.n, b.planned()
    speed = sent[:, n : 2 * n]
    jump = np.abs(np.diff(speed, axis=0)).max(axis=0) / SPEC.dt
    return (
        b.runtime.supervisor.mode[0] == Mode.LATCHED
        and not b.robot.sent[-1][0]
        and np.abs(speed[-1]).max() < 1e-9
        and (jump <= SPEC.joint_array("qdd_max") * (1 + 1e-6)).all()
    )


def moves(b, monkeypatch, action=1.0):
    """Let the policy swing the first joint."""
    say = np.zeros((1, SPEC.n), np.float32)
    say[0, 0] = action
    monkeypatch.setattr(b.policy, "step", lambda observation: say)


def test_run_arms_works_and_comes_to_rest(bench):
    b = bench(duration=1.0)
    assert b.live() is Ending.DONE
    assert comes_to_rest(b)
    powered = [powered for powered, _ in b.robot.sent]
    assert 200 <= sum(powered) <= 210
    assert not powered[0]
    assert (b.robot.cut, b.timing.clock.skipped) == (0, 0)
    assert b.run.statistics.stops == {"operator": 1}
    assert b.recorder.events == ()


def test_a_moving_arm_is_brought_to_rest_at_the_end(bench, monkeypatch):
    b = bench(duration=0.6)
    moves(b, monkeypatch)
    assert b.live() is Ending.DONE
    assert comes_to_rest(b)
    assert np.abs(b.planned()[:, SPEC.n]).max() > 0.5  # rad/s: it did move


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_non_finite_numbers_stop_the_robot_and_are_never_sent(bench, monkeypatch, bad):
    b = bench(duration=60.0)
    say = np.zeros((1, SPEC.n), np.float32)
    say[0, 0] = 1.0
    monkeypatch.setattr(b.policy, "step", lambda observation: say)
    b.at[100] = lambda: say.__setitem__((0, 3), bad)
    assert b.live() is Ending.STOPPED
    assert comes_to_rest(b)
    assert np.isfinite([numbers for _, numbers in b.robot.sent]).all()
    assert b.runtime.supervisor.reason[0] & Reason.NOT_FINITE
    assert b.run.statistics.stops["not_finite"] == 1
    assert 100 < b.runtime.ticks < 200
    assert len(b.recorder.events) == 1
    assert b.robot.cut == 0


ENDING = ("HUP", "INT", "QUIT", "USR1", "USR2", "ALRM", "TERM", "XCPU", "VTALRM", "PROF")
"""Signals of every system that end a process by default, and that it can handle."""


@pytest.mark.parametrize("name", ENDING)
def test_the_first_interrupt_is_a_controlled_stop(bench, monkeypatch, name):
    which = signal.Signals[f"SIG{name}"]
    b = bench(duration=60.0)
    moves(b, monkeypatch)
    b.at[100] = lambda: signal.raise_signal(which)
    before = signal.getsignal(which)
    assert b.live() is Ending.INTERRUPTED
    assert signal.getsignal(which) is before
    assert comes_to_rest(b)
    assert 100 < b.runtime.ticks < 200
    assert (b.robot.cut, len(b.recorder.events)) == (0, 1)


@pytest.mark.parametrize("first", [signal.SIGHUP, signal.SIGINT])
def test_no_other_signal_cuts_a_stop_short(bench, monkeypatch, first):
    """A service manager, a terminal that closes or a timer may send many: here all, at once and one by one."""
    b = bench(duration=60.0)
    moves(b, monkeypatch)
    others = [number for number in SIGNALS if number != signal.SIGINT]
    b.at[100] = lambda: [signal.raise_signal(number) for number in (first, *others)]
    for k, number in enumerate(others):
        b.at[101 + k] = partial(signal.raise_signal, number)
    assert b.live() is Ending.INTERRUPTED
    assert comes_to_rest(b)
    assert b.robot.cut == 0


def test_signals_of_failed_writes_stop_no_robot(bench, monkeypatch):
    """Python ignores them: the write that failed raises an error where it was made."""
    b = bench(duration=1.0)
    moves(b, monkeypatch)
    for k, name in enumerate(WRITE_ERRORS):
        b.at[100 + k] = partial(signal.raise_signal, signal.Signals[name])
    assert b.live() is Ending.DONE
    assert comes_to_rest(b)


def test_every_signal_is_of_a_known_kind():
    """What Linux and POSIX name, and no fault of this process."""
    assert {signal.Signals[f"SIG{name}"] for name in ENDING} <= set(SIGNALS)
    faults = {number for name in FAULTS if (number := getattr(signal, name, None))}
    assert not {*SIGNALS} & {signal.SIGKILL, signal.SIGSTOP, signal.SIGCHLD, signal.SIGWINCH, *faults}


@pytest.mark.parametrize("slot", [20, 50])
def test_an_interrupt_while_arming_moves_nothing(bench, slot):
    """Before the robot gets power, and before the policy may move it."""
    b = bench(duration=60.0)
    b.at[slot] = lambda: signal.raise_signal(signal.SIGINT)
    assert b.live() is Ending.INTERRUPTED
    sent = b.planned()
    assert bool(len(sent)) == (slot * SPEC.dt > ARM_AFTER_S)
    assert all((numbers == sent[0]).all() for numbers in sent)
    assert b.runtime.ticks < slot + 10


def test_a_second_ctrl_c_cuts_power(bench, monkeypatch):
    b = bench(duration=60.0)
    moves(b, monkeypatch)
    b.at[100] = b.at[103] = lambda: signal.raise_signal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        b.live()
    assert (b.robot.cut, b.run.ending) == (1, Ending.FAILED)
    assert b.robot.plant.braked.all()
    assert b.runtime.ticks <= 104


def test_a_second_ctrl_c_that_was_dropped_comes_with_the_next_one(bench, monkeypatch):
    """Python drops what is raised in a destructor; `raised_again` sends Ctrl-C once more."""
    b = bench(duration=60.0)
    moves(b, monkeypatch)

    def drop():
        with suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)

    b.at[100] = b.at[104] = lambda: signal.raise_signal(signal.SIGINT)
    b.at[102] = b.at[103] = drop
    with pytest.raises(KeyboardInterrupt):
        b.live()
    assert (b.robot.cut, b.run.ending) == (1, Ending.FAILED)
    assert b.robot.plant.braked.all()
    assert b.runtime.ticks <= 105


@pytest.mark.parametrize("error", [KeyboardInterrupt, ZeroDivisionError])
def test_no_ctrl_c_comes_between_an_error_and_power(bench, monkeypatch, error):
    b = bench(duration=60.0)

    def fail():
        raise error

    def stop(ids, cut=b.robot.stop):
        for _ in range(3):
            signal.raise_signal(signal.SIGINT)
        cut(ids)

    b.at[100] = fail
    monkeypatch.setattr(b.robot, "stop", stop)
    with pytest.raises(error):
        b.live()
    assert (b.robot.cut, b.run.ending) == (1, Ending.FAILED)
    assert b.robot.plant.braked.all()
    assert len(b.recorder.events) == 1


def test_no_ctrl_c_after_the_rest_cuts_the_files_short(bench):
    b = bench(duration=0.5)
    assert b.live() is Ending.DONE
    with handled(b.interrupts):
        for _ in range(3):
            signal.raise_signal(signal.SIGINT)


def test_unexpected_error_cuts_power_and_is_raised(bench, monkeypatch):
    b = bench(duration=60.0)

    def fail():
        raise ZeroDivisionError("a fault in the code")

    b.at[150] = fail
    with pytest.raises(ZeroDivisionError, match="a fault in the code"):
        b.live()
    assert (b.robot.cut, b.run.ending) == (1, Ending.FAILED)
    assert b.robot.plant.braked.all()
    assert len(b.recorder.events) == 1


def test_a_stop_that_does_not_end_cuts_power(bench, monkeypatch):
    b = bench(duration=0.5)
    monkeypatch.setattr(type(b.runtime.smoother), "at_rest", np.zeros(1, dtype=bool))
    with pytest.raises(RuntimeError, match=r"no rest within 5.8 s of asking for a stop"):
        b.live()
    assert b.robot.cut == 1


@pytest.mark.parametrize(("lost_s", "ending"), [(0.101, Ending.DONE), (0.2, Ending.STOPPED)])
def test_too_many_late_ticks_stop_the_robot(bench, lost_s, ending):
    b = bench(duration=1.0)
    b.at[100] = lambda: b.time.sleep(lost_s)
    assert b.live() is ending
    assert comes_to_rest(b)
    assert b.timing.clock.skipped == round(lost_s / SPEC.dt)
    assert ("overrun" in b.run.statistics.stops) is (ending is Ending.STOPPED)


def test_a_robot_that_is_too_hot_is_not_armed(bench):
    b = bench()
    b.robot.plant.housing[:] = 95.0
    b.robot.settle_sensors(np.ones(1, dtype=bool))
    assert b.live() is Ending.REFUSED
    assert b.run.reason == "a motor is too hot, or its temperature is unknown"  # all of them
    assert not any(powered for powered, _ in b.robot.sent)
