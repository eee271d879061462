import numpy as np

from deploy.estimation.estimator import Estimator
from deploy.state import Packet, Setpoint
from support.arm6 import SPEC

N, DT = SPEC.n, SPEC.dt
ENCODER, DENSITY = SPEC.sensors["encoder"], SPEC.joint_array("acceleration_density")
NOISE = np.sqrt(ENCODER.noise**2 + ENCODER.resolution**2 / 12)


def sample(t, fresh, q):
    """What the bus says; motors at rest."""
    q = np.array(q, dtype=float)
    t, fresh = np.array(t, dtype=float), np.array(fresh, dtype=bool)
    return {
        "encoder": Packet(t=t, fresh=fresh, value=q),
        "current": Packet(t=t, fresh=fresh, value=np.zeros_like(q)),
        "temperature": Packet(t=t, fresh=fresh, value=np.full_like(q, 30.0)),
    }


def sent(tick, robots):
    """Where the joints are sent: away on sines."""
    phase = tick * DT * 2.0 + np.arange(N) + np.arange(robots)[:, None]
    return Setpoint(q=np.sin(phase), qd=2.0 * np.cos(phase), qdd=-4.0 * np.sin(phase))


def still(robots, q=0.0):
    rest = np.zeros((robots, N))
    return Setpoint(q=rest + q, qd=rest, qdd=rest)


def packets(rng, robots, ticks, loss, lag_max=3):
    """What an unkind bus delivers: each robot its own delay, losses, dead channels, old packets that come again."""
    lag = rng.integers(0, lag_max + 1, robots)
    t, q = np.zeros(robots), np.full((robots, N), np.nan)
    for tick in range(ticks):
        fresh = rng.random(robots) >= loss
        repeat = rng.random(robots) < 0.05
        t = np.where(fresh & ~repeat, (tick - lag) * DT, t)
        away = 0.01 * np.sin(3.0 * tick * DT + np.arange(N))
        noisy = np.array([sent(tick - back, robots).q[i] for i, back in enumerate(lag)]) + away
        noisy += rng.normal(0, NOISE, (robots, N))
        noisy[rng.random((robots, N)) < 0.02] = np.nan
        q = np.where((fresh & ~repeat)[:, None], noisy, q)
        yield tick, sample(t, fresh, q), sent(tick, robots)


def begun(robots, rows=slice(None)):
    """An estimator that knows what was sent before the first packet."""
    estimator = Estimator(SPEC, len(np.arange(robots)[rows]))
    for tick in range(-10, 0):
        setpoint = Setpoint(*(part[rows] for part in sent(tick, robots)[:3]))
        silence = np.zeros(len(setpoint.q))
        estimator.step(tick * DT, sample(silence, silence, setpoint.q), setpoint)
    return estimator
