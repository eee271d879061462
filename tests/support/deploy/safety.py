import numpy as np

from deploy.reasons import Reason
from deploy.safety.safety import Safety
from deploy.state import STOP_MOMENTS, Setpoint, State, Stop
from robots.models.fleet import Fleet
from support.arm6 import SPEC

N = SPEC.n
HOME = SPEC.joint_array("q_home")
LOW, HIGH = (SPEC.joint_array(f"q_{end}") for end in ("min", "max"))
MARGINS, SPACE = SPEC.margins, SPEC.workspace
ZERO = np.zeros(N)
SAFETY = Safety(SPEC, Fleet(SPEC, 2, collisions=True))


def point(q=HOME, qd=ZERO, qdd=ZERO):
    return Setpoint(q=np.atleast_2d(q).copy(), qd=np.atleast_2d(qd).copy(), qdd=np.atleast_2d(qdd).copy())


FASTER_IN_ITS_STOP = (
    np.array([-0.167, -1.02, 1.885, -1.964, -1.113, 2.359]),
    np.array([2.832, -2.432, -2.057, -2.573, -2.592, 2.021]),
)
"""rad, rad/s: the tool's speed is 2.26 m/s here, and 2.43 m/s at the earlier moment of the stop."""


def stop_at(here):
    """A stop of robots that rest: everywhere the same setpoint."""
    q, qd, qdd = (np.array([each] * STOP_MOMENTS) for each in (here.q, here.qd, here.qdd))
    return Stop(here, q=q, qd=qd, qdd=qdd, q_rest=here.q)


def judge(
    *,
    q_hat=None,
    qd_hat=ZERO,
    sent=None,
    age=0.0,
    housing_c=30.0,
    hottest_c=40.0,
    current_share=1.0,
    setpoint=None,
    ahead=None,
    braking=None,
    q_rest=None,
    safety=SAFETY,
):
    """The verdict on one robot, everything else being well.

    braking: setpoints at moments of its stop, by their number; at the others it rests at home.
    """
    setpoint = setpoint or point()
    q_hat = setpoint.q if q_hat is None else np.atleast_2d(q_hat)
    state = State(
        t=1.0,
        q=q_hat,
        qd=np.atleast_2d(qd_hat),
        q_var=np.full((1, N), 1e-6),
        age=np.array([age]),
        nis=np.ones((1, N)),
        housing_c=np.broadcast_to(np.asarray(housing_c, dtype=float), (1, N)),
        winding_c=np.full((1, N), 40.0),
        hottest_c=np.broadcast_to(np.asarray(hottest_c, dtype=float), (1, N)),
        current_share=np.broadcast_to(np.asarray(current_share, dtype=float), (1, N)),
        fault=np.zeros(1, dtype=np.int64),
    )
    ahead = setpoint if ahead is None else ahead
    rest = setpoint.q if q_rest is None else np.atleast_2d(q_rest)
    moments = [(braking or {}).get(moment, point()) for moment in range(STOP_MOMENTS)]
    q, qd, qdd = (np.stack(each) for each in list(zip(*moments, strict=True))[:3])
    stop = Stop(ahead, q=q, qd=qd, qdd=qdd, q_rest=rest)
    return safety.step(state, sent or Setpoint(q=q_hat, qd=q_hat * 0, qdd=q_hat * 0), setpoint, stop)


def reasons(**situation):
    return Reason(int(judge(**situation).reason[0]))


def one(joint, value, base=ZERO):
    array = np.array(base, dtype=float)
    array[joint] = value
    return array
