"""Sessions of ONNX Runtime, with telemetry off and bounded memory and work; it is imported nowhere else."""

import os
from collections.abc import Sequence
from typing import TypeAlias

from deploy.policy.graph_bounds import check_bounds
from deploy.policy.onnx_graph import decode, shortened
from robots.errors import ContractError

# Read at the import: the library's own function to switch it off comes too late.
os.environ["ORT_DISABLE_TELEMETRY"] = "1"

import onnxruntime as ort

OnnxSession: TypeAlias = ort.InferenceSession
BATCHES = (1, 64)
"""Robots in a step for which a policy is checked: one, and many."""


def load_session(data: bytes, source: str, batches: Sequence[int] = BATCHES) -> OnnxSession:
    """Load a model into ONNX Runtime, on one thread; `source` names it in error messages.

    Args:
        batches: numbers of robots for a step of which the model's memory and work are bounded.

    Raises:
        ContractError: the model may need too much, or ONNX Runtime refuses it.
    """
    check_bounds(decode(data, source), batches, source)
    options = ort.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4  # what goes wrong is raised, not logged
    try:
        return ort.InferenceSession(data, options, providers=["CPUExecutionProvider"])
    except Exception as e:  # ONNX Runtime's errors share no base
        raise ContractError(f"{source}: ONNX Runtime refuses it: {shortened(e)}") from e
