import numpy as np
import pytest

from deploy.reasons import LATCHING, Reason
from deploy.state import Mode
from robots.models.fleet import Fleet
from robots.models.nominal_model import torque_max
from support.arm6 import SPEC

pytest.importorskip("mujoco")

from support.runtimes import assert_within_limits, running

N, SPACE = SPEC.n, SPEC.workspace
LOW, HIGH = (SPEC.joint_array(f"q_{end}") for end in ("min", "max"))


def hostile(runtime, ticks, seed=0):
    """Full-scale actions, new ones every 20, 200 or 800 ms: what was sent (T, B, n), modes, reasons and the truth."""
    rng, robots = np.random.default_rng(seed), runtime.robot.robots
    hold, action = np.tile([1, 10, 40], robots)[:robots], np.zeros((robots, N))
    sent, modes, reasons, truths = [], [], np.int64(0), []
    for tick in range(ticks):
        observation = runtime.sense()
        if observation is not None:
            fresh = tick // runtime.decimation % hold == 0
            action[fresh] = rng.choice([-1.0, 1.0, 3.0, -3.0, 0.2], (fresh.sum(), N))
        runtime.act(None if observation is None else action)
        truth = runtime.robot.truth()
        sent.append(runtime.command.q.copy())
        modes.append(runtime.supervisor.mode.copy())
        reasons |= np.bitwise_or.reduce(runtime.supervisor.reason)
        truths.append([a.copy() for a in (truth.q, truth.tau, truth.self_collision, truth.tool_position)])
    return (
        np.array(sent),
        np.array(modes),
        Reason(int(reasons)),
        [np.array(kind) for kind in zip(*truths, strict=True)],
    )


@pytest.mark.slow
def test_hostile_policy_stays_within_all_limits():
    """Ten seconds of sixteen drawn robots. Truth stays inside what only the model was asked about."""
    sent, modes, reasons, (q, tau, collision, tool) = hostile(running(16), 2000)
    assert_within_limits(sent)
    assert not collision.any()
    assert (q >= LOW).all()
    assert (q <= HIGH).all()
    assert (np.abs(tau) <= torque_max(SPEC) * (1 + 1e-9)).all()
    assert tool[..., 2].min() > SPACE.z_min
    assert np.linalg.norm(tool - SPACE.centre, axis=-1).max() < SPACE.radius_max
    fleet = Fleet(SPEC, 16)
    for pose in q[::4]:
        kinematics = fleet.kinematics(pose)
        assert (kinematics.manipulability() > 0).all()  # no singularity was passed
    assert not (modes == Mode.LATCHED).any()
    assert Reason.WORKSPACE | Reason.COLLISION in reasons
    assert reasons & LATCHING == 0
    assert 0.3 < (modes == Mode.RUNNING).mean() < 0.95


@pytest.mark.slow
def test_hostile_policy_without_safety_breaks_limits():
    """Or the test above would prove nothing; without external torque detection too. Half of the time is enough."""
    runtime = running(16)
    judged = runtime.safety.step

    def blind(*args):
        verdict = judged(*args)
        verdict.reason[:] = 0
        return verdict

    runtime.safety.step = blind
    runtime.estimator.external_torque.look = lambda current: np.zeros(16, dtype=bool)
    _, _, _, (_, _, collision, tool) = hostile(runtime, 1000)
    assert collision.any(axis=0).sum() >= 4
    assert tool[..., 2].min() < SPACE.z_min - 0.02
