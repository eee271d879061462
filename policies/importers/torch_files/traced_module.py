"""Torch modules of other people: what they keep in their buffers becomes an input and an output."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from operator import attrgetter
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from onnx import ModelProto
from torch import Tensor, nn
from torch.fx.experimental.proxy_tensor import make_fx

from deploy.policy.onnx_graph import check_model, shortened
from policies.export.tracing import to_onnx
from policies.importers.onnx_files.foreign_onnx import widened
from policies.importers.reference_policy import Facts, Memory, Original
from robots.arrays import Float32s
from robots.errors import ContractError

OBSERVATION, ACTION = "obs", "actions"


def read_module(
    module: nn.Module, observations: int, source: str, *, kind: str, known: Mapping[str, Any] | None = None
) -> Original:
    """The original that a module is, asked with (1, N) observations for (1, A) actions.

    Buffers that a step changes, in place or for another tensor, are what it remembers.

    Raises:
        ContractError: it cannot be run or traced, or what it remembers does not begin at 0.
    """
    owner = _Owner(module.eval(), source)
    example = torch.randn(1, observations, generator=torch.Generator().manual_seed(0))
    with _running(source):
        actions = owner.ask(example).shape[-1]
        names = owner.changed()
        if begun := [name for name in names if owner.begin[name].any()]:
            raise ContractError(f"{source}: {begun[0]}: found a memory that does not begin at 0")
        memory = tuple(
            Memory(before=f"memory_{k}", after=f"next_{k}", shape=tuple(owner.begin[name].shape))
            for k, name in enumerate(names)
        )
        model = _graph(owner, example, names, memory)
    check_model(model, source)
    original = Original(
        facts=Facts(kind=kind, observations=observations, actions=actions, known=known or {}),
        model=model,
        observation=OBSERVATION,
        action=ACTION,
        memory=memory,
        batched=False,
        play=owner.play,
    )
    return widened(original, source)


class _Owner:
    """A module, and what its buffers were in the beginning."""

    def __init__(self, module: nn.Module, source: str) -> None:
        self.module, self._source = module, source
        self.begin = {name: buffer.detach().clone() for name, buffer in module.named_buffers()}

    def changed(self) -> list[str]:
        """Buffers that are not what they were."""
        return [name for name, was in self.begin.items() if not torch.equal(self.get(name), was)]

    def get(self, name: str) -> Tensor:
        """One buffer."""
        tensor: Tensor = attrgetter(name)(self.module)
        return tensor

    def put(self, name: str, value: Tensor) -> None:
        """Another tensor in its place."""
        path, _, attribute = name.rpartition(".")
        setattr(attrgetter(path)(self.module) if path else self.module, attribute, value)

    def restart(self) -> None:
        """As in the beginning."""
        for name, was in self.begin.items():
            self.put(name, was.clone())

    def ask(self, observation: Tensor) -> Tensor:
        """(1, N) to (1, A), as its owners ask it."""
        action = self.module(observation)
        if not isinstance(action, Tensor) or action.dim() != 2 or len(action) != 1:
            found = tuple(action.shape) if isinstance(action, Tensor) else type(action).__name__
            raise ContractError(f"{self._source}: found an action of {found}, expected one tensor (1, A)")
        return action

    def play(self, observations: Float32s, forget: NDArray[np.bool_]) -> Float32s:
        """As `original.Play` says."""
        actions = []
        with _running(self._source):
            for row, anew in zip(torch.from_numpy(observations), forget, strict=True):
                if anew:
                    self.restart()
                actions.append(self.ask(row[None])[0].numpy().copy())
        return np.array(actions, dtype=np.float32)


def _graph(owner: _Owner, example: Tensor, names: list[str], memory: tuple[Memory, ...]) -> ModelProto:
    def step(observation: Tensor, *known: Tensor) -> tuple[Tensor, ...]:
        for name, piece in zip(names, known, strict=True):
            owner.put(name, piece.clone())
        action = owner.module(observation)
        return action, *(owner.get(name).clone() for name in names)

    arguments = (example, *(owner.begin[name].clone() for name in names))
    try:
        functional: Callable[..., tuple[Tensor, ...]] = torch.func.functionalize(step)
        graph = make_fx(functional)(*arguments).eval()
    finally:
        owner.restart()
    inputs, outputs = [piece.before for piece in memory], [piece.after for piece in memory]
    return to_onnx(graph, arguments, [OBSERVATION, *inputs], [ACTION, *outputs])


@contextmanager
def _running(source: str) -> Iterator[None]:
    """Without gradients, and without kernels of one processor that no graph can hold."""
    # Not its context manager `flags`, which warns of a GPU that is not there.
    enabled, *_ = torch.backends.mkldnn.set_flags(_enabled=False, _fp32_precision=None)
    try:
        with torch.no_grad():
            yield
    except ContractError:
        raise
    except Exception as e:  # whatever a foreign module does
        raise ContractError(f"{source}: cannot be run or traced: {shortened(e)}") from e
    finally:
        torch.backends.mkldnn.set_flags(_enabled=enabled, _fp32_precision=None)
