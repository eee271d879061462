"""Reference policy from a torch module: traced to ONNX, with changing buffers as memory input and output."""

import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from operator import attrgetter, itemgetter
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from onnx import ModelProto
from torch import Tensor, nn
from torch.fx.experimental.proxy_tensor import make_fx
from torch.nn.attention import SDPBackend, sdpa_kernel

from deploy.policy.onnx_graph import check_model, shortened
from policies.export.tracing import to_onnx
from policies.importers.onnx_files.foreign_onnx import allow_any_batch
from policies.importers.reference_policy import Memory, PolicyFacts, ReferencePolicy
from policies.importers.untrusted.zip_archive import BYTES_MAX
from robots.arrays import Float32s
from robots.errors import ContractError

OBSERVATION, ACTION = "obs", "actions"
Fields = Mapping[str, Any]


def trace_module(
    module: nn.Module, observations: int, source: str, *, kind: str, known: Fields | None = None, **more: Any
) -> ReferencePolicy:
    """Trace a module from observations (1, N) to actions (1, A); `more` are further fields of the result.

    Buffers that a step changes, in place or by assignment, become the memory, which must start at 0.
    """
    _check_size(module, source)
    stateful = _StatefulModule(module.eval(), source)
    example = torch.randn(1, observations, generator=torch.Generator().manual_seed(0))
    with _inference_mode(source):
        actions = stateful.act(example).shape[-1]
        names = stateful.changed_buffers()
        memory = _memory(stateful, names, source)
        model = _graph(stateful, example, names, memory)
    check_model(model, source)
    facts = PolicyFacts(kind=kind, observations=observations, actions=actions, known=known or {})
    fields = {"memory": memory, "run": stateful.run, **more}
    reference = ReferencePolicy(
        facts=facts, model=model, observation=OBSERVATION, action=ACTION, batched=False, **fields
    )
    return allow_any_batch(reference, source)


def _check_size(module: nn.Module, source: str) -> None:
    """Refuse (ContractError) parameters and buffers of too many bytes: one in a small file can claim any number."""
    tensors = dict((*module.named_parameters(), *module.named_buffers()))
    sizes = {name: tensor.numel() * tensor.element_size() for name, tensor in tensors.items()}
    if (total := sum(sizes.values())) > BYTES_MAX:
        name, size = max(sizes.items(), key=itemgetter(1))
        found = f"found {size} bytes, and {total} in all parameters and buffers"
        raise ContractError(f"{source}: {name!r:.100}: {found}, expected at most {BYTES_MAX}")


def _memory(stateful: "_StatefulModule", names: list[str], source: str) -> tuple[Memory, ...]:
    for name in names:
        if stateful.initial[name].any():
            raise ContractError(f"{source}: {name}: found a memory that does not start at 0")
    shapes = [tuple(stateful.initial[name].shape) for name in names]
    return tuple(
        Memory(input_name=f"memory_{k}", output_name=f"next_{k}", shape=shape)
        for k, shape in enumerate(shapes)
    )


class _StatefulModule:
    """A module with its initial buffers."""

    def __init__(self, module: nn.Module, source: str) -> None:
        self.module, self._source = module, source
        self.initial = {name: buffer.detach().clone() for name, buffer in module.named_buffers()}

    def changed_buffers(self) -> list[str]:
        """Return the names of buffers that changed."""
        return [name for name, value in self.initial.items() if not torch.equal(self.buffer(name), value)]

    def buffer(self, name: str) -> Tensor:
        """Return a buffer."""
        tensor: Tensor = attrgetter(name)(self.module)
        return tensor

    def set_buffer(self, name: str, value: Tensor) -> None:
        """Replace a buffer."""
        path, _, attribute = name.rpartition(".")
        setattr(attrgetter(path)(self.module) if path else self.module, attribute, value)

    def restart(self) -> None:
        """Restore the initial buffers."""
        for name, initial_value in self.initial.items():
            self.set_buffer(name, initial_value.clone())

    def act(self, observation: Tensor) -> Tensor:
        """Return the action (1, A) for an observation (1, N)."""
        action = self.module(observation)
        if not isinstance(action, Tensor) or action.dim() != 2 or len(action) != 1:
            found = tuple(action.shape) if isinstance(action, Tensor) else type(action).__name__
            raise ContractError(f"{self._source}: found an action of {found}, expected one tensor (1, A)")
        return action

    def run(self, observations: Float32s, resets: NDArray[np.bool_]) -> Float32s:
        """Return actions, as `reference_policy.RunSequence`."""
        actions = []
        with _inference_mode(self._source):
            for row, reset in zip(torch.from_numpy(observations), resets, strict=True):
                if reset:
                    self.restart()
                actions.append(self.act(row[None])[0].numpy().copy())
        return np.array(actions, dtype=np.float32)


def _graph(
    stateful: _StatefulModule, example: Tensor, names: list[str], memory: tuple[Memory, ...]
) -> ModelProto:
    def step(observation: Tensor, *states: Tensor) -> tuple[Tensor, ...]:
        for name, state in zip(names, states, strict=True):
            stateful.set_buffer(name, state.clone())
        action = stateful.module(observation)
        return action, *(stateful.buffer(name).clone() for name in names)

    arguments = (example, *(stateful.initial[name].clone() for name in names))
    try:
        graph = make_fx(torch.func.functionalize(step))(*arguments).eval()
    finally:
        stateful.restart()
    inputs, outputs = [part.input_name for part in memory], [part.output_name for part in memory]
    return to_onnx(graph, arguments, [OBSERVATION, *inputs], [ACTION, *outputs])


@contextmanager
def _inference_mode(source: str) -> Iterator[None]:
    try:
        with safe_kernels():
            yield
    except ContractError:
        raise
    except Exception as e:  # a foreign module can raise anything
        raise ContractError(f"{source}: cannot be run or traced: {shortened(e)}") from e


@contextmanager
def safe_kernels() -> Iterator[None]:
    """Run without gradients, warnings of foreign code, and kernels that do not check shapes or that ONNX lacks."""
    # Not its context manager `flags`, which warns of a GPU that is not there.
    enabled, *_ = torch.backends.mkldnn.set_flags(_enabled=False, _fp32_precision=None)
    try:
        with torch.no_grad(), sdpa_kernel(SDPBackend.MATH), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        torch.backends.mkldnn.set_flags(_enabled=enabled, _fp32_precision=None)
