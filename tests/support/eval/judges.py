import pytest

pytest.importorskip("mujoco")

from dataclasses import dataclass, fields

import numpy as np

from deploy.policy.contract import Observed
from deploy.state import Command, Mode, State, Target
from eval.judge.judge import EVENT_GAP_S
from eval.judge.limits import load_limits
from eval.judge.monitors import NAMES
from support.arm6 import SPEC, arm_judge, position_drives

N, DT = SPEC.n, SPEC.dt
TORQUE_MAX = np.array([150.0, 150.0, 150.0, 28.0, 28.0, 28.0])
HOME = SPEC.joint_array("q_home")
Q_MIN, Q_MAX = SPEC.joint_array("q_min"), SPEC.joint_array("q_max")
GAP = round(EVENT_GAP_S / DT)


@dataclass(frozen=True, slots=True)
class World:
    """A truth whose arrays a test may change."""

    q: np.ndarray
    qd: np.ndarray
    tau: np.ndarray
    winding_c: np.ndarray
    tool_position: np.ndarray
    tool_velocity: np.ndarray
    self_collision: np.ndarray
    contact_n: np.ndarray
    valid: np.ndarray
    base = None
    allowed_contact_n = None


SIZE = 5
OBSERVED = Observed(mean=tuple(np.arange(SIZE)), deviation=(0.5,) * SIZE)


def believed(q, q_var, age):
    """A state of which the judge needs only this much."""
    nothing = dict.fromkeys(State._fields)
    return State(**(nothing | {"q": q, "q_var": q_var, "age": age}))


class Bench:
    """A judge over robots at rest at home, under way, on which nothing is wrong until a test says so."""

    def __init__(self, robots=1):
        self.judge = arm_judge(TORQUE_MAX, robots, observed=OBSERVED)
        self.truth = World(
            q=np.tile(HOME, (robots, 1)),
            qd=np.zeros((robots, N)),
            tau=np.zeros((robots, N)),
            winding_c=np.full((robots, N), 25.0),
            tool_position=np.tile([0.4, 0.0, 0.4], (robots, 1)),
            tool_velocity=np.zeros((robots, 3)),
            self_collision=np.zeros(robots, dtype=bool),
            contact_n=np.zeros(robots),
            valid=np.ones(robots, dtype=bool),
        )
        self.target = Target(
            position_drives(robots), np.tile(HOME, (robots, 1)), finite=np.ones(robots, dtype=bool)
        )
        self.drive = position_drives(robots)
        self.sent, self.tau_sent = np.tile(HOME, (robots, 1)), np.zeros((robots, N))
        self.speed_sent = np.zeros((robots, N))
        self.was = np.tile(HOME, (robots, 1))
        self.q_var, self.age = np.full((robots, N), 1e-6), np.zeros(robots)
        self.off, self.observation = (
            np.zeros((robots, N)),
            np.tile(OBSERVED.mean, (robots, 1)).astype(np.float32),
        )
        self.action = np.zeros((robots, N))
        self.powered = np.ones(robots, dtype=bool)
        self.mode = np.full(robots, Mode.RUNNING, dtype=np.int8)
        self.reason = np.zeros(robots, dtype=np.int64)
        self.goal = np.tile([0.4, 0.0, 0.4], (robots, 1))
        self.goal_number, self.attempted = np.zeros((2, robots), dtype=np.int64)

    def step(self, ticks=1):
        sent = self.drive, self.sent, self.speed_sent, self.tau_sent
        command = Command(*sent, self.powered, current_share=self.sent)
        for tick in range(ticks):
            was = self.was if tick == 0 else self.truth.q
            self.judge.step(
                truth=self.truth,
                state=believed(was + self.off, self.q_var, self.age),
                observation=self.observation,
                target=self.target,
                action=self.action,
                command=command,
                mode=self.mode,
                reason=self.reason,
                achieved=self.truth.tool_position,
                goal=self.goal,
                goal_number=self.goal_number,
                attempted=self.attempted,
            )
        self.was = self.truth.q.copy()

    def fired(self):
        counts = self.judge.counts()
        return {name for name in NAMES if counts.total(name)}


CENTRE, SPACE = np.array(SPEC.workspace.centre), SPEC.workspace
LIMITS = load_limits(SPEC)
POWER, RATE = LIMITS.motor_array("power_w", SPEC), LIMITS.motor_array("torque_rate", SPEC)


def hold(bench, joint, q):
    bench.truth.q[0, joint] = bench.sent[0, joint] = q


def random_series(ticks, robots, seed):
    """Everything random around its limit, so that every channel goes in and out; some NaN, some diverged."""
    rng = np.random.default_rng(seed)
    wide = rng.normal(size=(15, ticks, robots, N))
    half = (Q_MAX - Q_MIN) / 2
    middle = (Q_MAX + Q_MIN) / 2
    sent = HOME + np.cumsum(0.006 * wide[5], axis=0)
    series = {
        "q": np.where(wide[6] > 2, sent + 0.1 * wide[7], sent),
        "qd": 2.0 * wide[0],
        "tau": 0.6 * TORQUE_MAX * wide[1],
        "winding_c": 80 + 20 * wide[2],
        "tool_position": CENTRE + 0.4 * rng.normal(size=(ticks, robots, 3)),
        "tool_velocity": 1.2 * rng.normal(size=(ticks, robots, 3)),
        "self_collision": rng.random((ticks, robots)) < 0.02,
        "contact_n": 70 * rng.normal(size=(ticks, robots)),
        "valid": rng.random((ticks, robots)) > 0.03,
        "target": middle + half * 0.7 * wide[4],
        "sent": sent,
        "tau_sent": 0.5 * RATE * DT * wide[8],
        "off": 0.003 * wide[9],
        "q_var": 1e-6 * np.exp(0.3 * wide[10]),
        "age": np.where(rng.random((ticks, robots)) > 0.1, 0.01, np.inf),
        "observation": (np.array(OBSERVED.mean) + 2 * rng.normal(size=(ticks, robots, SIZE))).astype(
            np.float32
        ),
        "said": np.where(rng.random((ticks, robots, N)) < 0.05, np.nan, wide[14]),
        "powered": rng.random((ticks, robots)) > 0.1,
        "mode": rng.choice([1, 2, 2, 2, 3, 4, 5], size=(ticks, robots)).astype(np.int8),
        "reason": rng.integers(0, 1 << 15, size=(ticks, robots)) * (rng.random((ticks, robots)) > 0.2),
        "goal": CENTRE + 0.4 * rng.normal(size=(ticks, robots, 3)),
        "attempted": np.cumsum(rng.random((ticks, robots)) < 0.05, axis=0),
    }
    series["q"][rng.random(series["q"].shape) < 0.001] = np.nan
    hit = rng.random((ticks, robots)) < 0.5
    series["tool_position"][1:][hit[1:]] = series["goal"][:-1][hit[1:]] + 0.015
    series["tool_position"][1:][hit[1:], :2] -= 0.015
    return series


def feed(judge, series, ticks, rows=slice(None)):
    for t in ticks:
        at = {name: array[t, rows] for name, array in series.items()}
        truth = World(**{field.name: at[field.name] for field in fields(World)})
        judge.step(
            truth=truth,
            target=Target(position_drives(len(at["q"])), at["target"], finite=at["powered"]),
            action=None if t % 4 else at["said"],
            state=believed(at["off"] + np.nan_to_num(at["q"]), at["q_var"], at["age"]),
            observation=at["observation"],
            command=Command(
                drive=position_drives(len(at["q"])),
                q=at["sent"],
                qd=at["sent"],
                tau=at["tau_sent"],
                powered=at["powered"],
                current_share=at["sent"],
            ),
            mode=at["mode"],
            reason=at["reason"],
            achieved=at["tool_position"],
            goal=at["goal"],
            goal_number=at["attempted"],
            attempted=at["attempted"],
        )
