"""ONNX file of a policy: written only after it was loaded on its robot and compared with the original."""

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from onnx import ModelProto, helper

from deploy.policy.contract import Contract
from deploy.policy.policy import Policy
from deploy.policy.policy_file import Golden
from deploy.policy.policy_names import CONTRACT_KEY, GOLDEN_KEY
from deploy.telemetry.output_files import replacing
from robots.errors import ContractError
from robots.spec import RobotSpec

T = TypeVar("T")
Compare = Callable[[Policy], T]


def write_policy(
    out_path: Path,
    model: ModelProto,
    contract: Contract,
    golden: Golden,
    spec: RobotSpec,
    compare: Compare[T],
) -> tuple[str, T]:
    """Write the file if it loads on its robot and `compare` accepts it; return its SHA-256 and the comparison."""
    helper.set_model_props(model, {CONTRACT_KEY: contract.to_json(), GOLDEN_KEY: golden.model_dump_json()})
    with replacing(out_path) as partial:
        partial.write_bytes(model.SerializeToString(deterministic=True))
        try:
            policy = Policy.load(partial, spec)
        except ContractError as e:
            raise ContractError(str(e).replace(str(partial), f"{out_path} (not written)")) from e
        return policy.digest, compare(policy)


def strip_annotations(model: ModelProto) -> None:
    """Remove comments, metadata (torch's has stack traces with local paths), and shapes of one batch size."""
    graph = model.graph
    del model.metadata_props[:], graph.value_info[:]
    model.ClearField("doc_string")
    for part in (graph, *graph.node, *graph.initializer, *graph.input, *graph.output):
        part.ClearField("doc_string")
        part.ClearField("metadata_props")
