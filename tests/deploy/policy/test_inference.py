"""Side effects of the import of ONNX Runtime."""

import os
import subprocess
import sys

from support.paths import ROOT

RUN = """
import sys
from pathlib import Path
import numpy as np
from deploy.policy.inference import load_session

policy = Path(sys.argv[1])
session = load_session(policy.read_bytes(), str(policy))
(observation,) = session.get_inputs()
session.run(None, {observation.name: np.zeros((1, observation.shape[1]), dtype=np.float32)})
"""


def test_onnx_runtime_collects_nothing(arm_policy, tmp_path):
    """With telemetry it writes an identifier and a database at home before it sends anything."""
    unset = ("ORT_DISABLE_TELEMETRY", "XDG_CACHE_HOME")
    environment = {name: value for name, value in os.environ.items() if name not in unset}
    environment |= {"HOME": str(tmp_path), "PYTHONPATH": str(ROOT)}
    subprocess.run([sys.executable, "-c", RUN, arm_policy], env=environment, check=True)
    assert os.listdir(tmp_path) == []
