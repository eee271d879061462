"""Digest of what the estimator makes of late, lost, wild and missing samples, with and without compiled kernels.

A program of its own, because numba reads NUMBA_DISABLE_JIT when it is imported.
"""

import hashlib

import numpy as np

from support.deploy.estimators import DT, begun, packets


def estimate_digest() -> str:
    """Return the digest of 200 ticks of 3 robots."""
    rng, digest, estimator = np.random.default_rng(3), hashlib.sha256(), begun(3)
    estimator.joints.rules = estimator.joints.rules._replace(r_speed=1e-4)  # as with a sensor of speeds
    for tick, sample, setpoint in packets(rng, 3, 200, 0.3):
        value = sample["encoder"].value
        wild = rng.random(value.shape)
        value[wild < 0.02] = np.nan
        value[wild > 0.97] += 1.0
        speeds = setpoint.qd + rng.normal(0.0, 0.01, value.shape)
        sample["velocity"] = sample["encoder"]._replace(value=np.where(wild < 0.1, np.nan, speeds))
        state = estimator.step(tick * DT, sample, setpoint)
        for name in ("q", "qd", "q_var", "age", "nis"):
            digest.update(getattr(state, name).tobytes())
    return digest.hexdigest()


if __name__ == "__main__":
    print(estimate_digest())
