"""Reader of torch.export programs, without the parts that torch would unpickle or evaluate."""

import re
from pathlib import Path

from torch import nn
from torch.export import ExportedProgram
from torch.export.pt2_archive._package import load_pt2

from deploy.policy.contract_term import SIZE_MAX
from policies.importers.reference_policy import ReferencePolicy
from policies.importers.torch_files.exported_program_check import check_tensors, sanitize_program
from policies.importers.torch_files.network_settings import NetworkSettings
from policies.importers.torch_files.traced_module import trace_module
from policies.importers.untrusted.zip_archive import in_folder, read_bytes, read_torch_members, repack
from robots.errors import ContractError

PROGRAM, EXAMPLES = "models/model.json", "data/sample_inputs/model.pt"
TENSORS = {
    "data/weights/": "data/weights/model_weights_config.json",
    "data/constants/": "data/constants/model_constants_config.json",
}
VERSIONS = ("archive_format", "archive_version", ".data/version", "byteorder")
NEEDED = re.compile(
    "|".join(map(re.escape, (PROGRAM, *TENSORS.values(), *VERSIONS)))
    + r"|data/weights/weight_\d+|data/constants/tensor_\d+"
)
"""Members that are read; excluded are pickled examples and objects, and compiled libraries."""
EXPECTED = "expected a file of torch.export.save"


def read_exported_program(path: Path, _network: NetworkSettings | None = None) -> ReferencePolicy:
    """Read a file of `torch.export.save`; buffers that the program changes become its memory."""
    source = str(path)
    members = read_torch_members(read_bytes(path, EXPECTED), NEEDED, source, EXPECTED)
    if missing := [name for name in (PROGRAM, *TENSORS.values(), *VERSIONS) if name not in members]:
        raise ContractError(f"{source}: found no {missing[0]}, {EXPECTED}")
    for folder, config in TENSORS.items():
        check_tensors(members[config], in_folder(members, folder), f"{source}: {config}")
    members[PROGRAM] = sanitize_program(members[PROGRAM], f"{source}: {PROGRAM}")
    members[EXAMPLES] = b""
    program = load_pt2(repack(members)).exported_programs["model"]
    return trace_module(_module(program), _observations(program, source), source, kind="torch.export program")


def _module(program: ExportedProgram) -> nn.Module:
    module = program.module(check_guards=False)
    del module.train, module.eval  # both raise for exported programs
    return module


def _observations(program: ExportedProgram, source: str) -> int:
    names = program.graph_signature.user_inputs
    values = [n.meta["val"] for n in program.graph.nodes if n.op == "placeholder" and n.name in names]
    shapes = [tuple(getattr(value, "shape", ())) for value in values]
    if len(shapes) != 1 or len(shapes[0]) != 2:
        raise ContractError(f"{source}: found inputs of shapes {shapes}, expected (batch, observations)")
    batch, size = shapes[0]
    if (isinstance(batch, int) and batch != 1) or not isinstance(size, int) or not 0 < size <= SIZE_MAX:
        raise ContractError(
            f"{source}: found observations of shape ({batch}, {size}), expected a batch of 1 or of any size,"
            f" and 1 to {SIZE_MAX} numbers"
        )
    return size
