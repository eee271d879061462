"""What every importer is put through: also for those whose contract nobody has written yet."""

from types import SimpleNamespace

import numpy as np

from deploy.policy.onnx_graph import check_model
from deploy.policy.policy import Policy
from policies.importers.parity import check_parity, record_reference
from policies.importers.standard_graph import to_standard_graph


def parity(original, source="file", seed=5):
    """The worst deviation of our file from an original whose numbers stand in any other order than ours."""
    rng = np.random.default_rng(seed)
    columns, joints = rng.permutation(original.facts.observations), rng.permutation(original.facts.actions)
    return check_parity(ours(original, columns, joints), record_reference(original, columns, joints), source)


def ours(original, columns, joints):
    """Our file of it, loaded."""
    model = to_standard_graph(original, columns.tolist(), joints.tolist())
    check_model(model, "ours")
    sizes = {"observation_size": original.facts.observations, "action_size": original.facts.actions}
    contract = SimpleNamespace(**sizes, memory=original.memory_size)
    return Policy(SimpleNamespace(data=model.SerializeToString(), digest="", contract=contract), "ours")
