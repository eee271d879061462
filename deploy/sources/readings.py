"""Raw readings of sensors for a policy: the newest packet, with a defined number where there is no reading."""

from typing import TYPE_CHECKING

import numpy as np

from robots.arrays import Floats
from robots.sensors import Kind

if TYPE_CHECKING:
    from deploy.runtime import Runtime

SILENT_S = 1.0
"""s without a packet after which a sensor counts as silent: all of its channels are without reading."""


def sensor_reading(runtime: "Runtime", kind: Kind, missing: float = 0.0) -> Floats:
    """Return (B, channels) of the newest packet of a sensor; `missing` where a channel has no reading."""
    packet = runtime.sample[kind]
    heard = runtime.t - packet.t <= SILENT_S
    return np.where(np.isfinite(packet.value) & heard[:, None], packet.value, missing)
