"""Reader of TorchScript policies; torch runs their code, so every line is checked before loading."""

import re
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from deploy.policy.contract_term import SIZE_MAX
from policies.importers.reference_policy import ReferencePolicy
from policies.importers.torch_files.network_settings import NetworkSettings
from policies.importers.torch_files.torchscript_check import check_graph, check_pickle, check_source
from policies.importers.torch_files.traced_module import safe_kernels, trace_module
from policies.importers.untrusted.resource_limits import limit_cpu
from policies.importers.untrusted.zip_archive import in_folder, read_bytes, read_torch_members, repack
from robots.errors import ContractError

NEEDED = re.compile(
    r"data\.pkl|constants\.pkl|(\.data/)?version|byteorder|(data|constants)/\d+|code/[\w/]+\.py"
)
"""Members that are read; debug files and extra files are excluded."""
EXPECTED = "expected a file of torch.jit.save"
TRIED_MAX = 32
LOAD_CPU_S = 30
"""Time on a core to load and inline: methods that call each other can double the graph with each call."""


def read_torchscript(path: Path, _network: NetworkSettings | None = None) -> ReferencePolicy:
    """Read a file of `torch.jit.save`; buffers that a step changes become the memory.

    The file does not state the observation size: the first size among its weights that runs is taken.
    """
    source = str(path)
    members = read_torch_members(read_bytes(path, EXPECTED), NEEDED, source, EXPECTED)
    _check(members, source)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "`torch.jit")  # deprecated; the files of others stay
        observations = _observations(_load(members, source), source)
        module = _load(members, source)  # loaded again: trial runs may have changed its buffers
        return trace_module(module, observations, source, kind="TorchScript")


def _check(members: Mapping[str, bytes], source: str) -> None:
    if not {"data.pkl", "constants.pkl"} <= members.keys():
        raise ContractError(f"{source}: found no data.pkl and constants.pkl, {EXPECTED}")
    for folder in ("data", "constants"):
        storages = in_folder(members, f"{folder}/")
        check_pickle(members[f"{folder}.pkl"], storages, f"{source}: {folder}.pkl")
    for name, text in members.items():
        if name.endswith(".py"):
            check_source(text, f"{source}: {name}")


def _load(members: Mapping[str, bytes], source: str) -> torch.jit.ScriptModule:
    with limit_cpu(LOAD_CPU_S):
        module = torch.jit.load(repack(members), map_location="cpu")
        graph: Any = module.inlined_graph
    check_graph((node.kind() for node in _nodes(graph)), source)
    buffers = {name.rpartition(".")[2] for name, _ in module.named_buffers()}
    for node in graph.findAllNodes("prim::SetAttr"):
        if (name := node.s("name")) not in buffers:
            found = f"{name}: found state ({list(node.inputs())[1].type()}) in an attribute"
            raise ContractError(f"{source}: {found}, expected it in a buffer")
    return module


def _nodes(graph: Any) -> Iterator[Any]:
    """Yield the nodes of a graph, with those of its branches and loops, however deep they are nested."""
    blocks = [graph]
    while blocks:
        for node in blocks.pop().nodes():
            yield node
            blocks.extend(node.blocks())


def _observations(module: torch.jit.ScriptModule, source: str) -> int:
    tried = list(dict.fromkeys(size for size in _sizes(module) if 0 < size <= SIZE_MAX))[:TRIED_MAX]
    for size in tried:
        if _runs(module, size):
            return size
    raise ContractError(f"{source}: cannot be run with any observation size of its weights: {tried}")


def _sizes(module: torch.jit.ScriptModule) -> Iterator[int]:
    graph: Any = module.inlined_graph
    constants = (
        node.t("value")
        for node in graph.findAllNodes("prim::Constant")
        if node.hasAttribute("value") and node.kindOf("value") == "t"
    )
    for tensor in (*module.parameters(), *constants, *module.buffers()):
        if tensor.dim() == 2:
            yield tensor.shape[1]


def _runs(module: torch.jit.ScriptModule, size: int) -> bool:
    try:
        with safe_kernels():
            return isinstance(module.eval()(torch.zeros(1, size)), Tensor)
    except Exception:  # noqa: BLE001 - a foreign module can raise anything
        return False
