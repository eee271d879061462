"""Reader of policies of Stable-Baselines3: PPO, A2C, SAC, TD3 and DDPG, from the zip that `save` writes.

The action is that of `predict(deterministic=True)` before the action space is applied. For SAC, TD3 and DDPG it is in
[-1, 1], and the contract's scale and offset map it to the space's bounds instead of `predict`. For PPO and A2C it is
unbounded, and the contract's clip replaces the clipping of `predict`.
"""

import itertools
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from deploy.policy.contract_term import SIZE_MAX
from policies.importers.reference_policy import PolicyFacts, ReferencePolicy
from policies.importers.stable_baselines.archive import read_zip
from policies.importers.stable_baselines.vec_normalize import VecNormalize, read_vec_normalize
from policies.importers.torch_files.mlp import ACTIVATIONS, Normalizer, build_mlp, linear_layer
from policies.importers.torch_files.network_settings import Activation, NetworkSettings, require_settings
from policies.importers.torch_files.traced_module import trace_module
from robots.errors import ContractError

FLATTEN = "<class 'stable_baselines3.common.torch_layers.FlattenExtractor'>"


class _Family(NamedTuple):
    """Algorithms with the same tensor names.

    Attributes:
        kind: in words.
        hidden: prefix of the actor's hidden layers. head: name of its last layer, if separate.
        ignored: prefixes of tensors that deterministic actions do not use.
        activation: default between layers.
        squashed: True if the last operation is tanh.
    """

    kind: str
    hidden: str
    head: tuple[str, ...]
    ignored: tuple[str, ...]
    activation: Activation
    squashed: bool


FAMILIES = {
    "stable_baselines3.common.policies": _Family(
        kind="PPO or A2C of Stable-Baselines3",
        hidden="mlp_extractor.policy_net.",
        head=("action_net",),
        ignored=("log_std", "mlp_extractor.value_net.", "value_net."),
        activation="tanh",
        squashed=False,
    ),
    "stable_baselines3.sac.policies": _Family(
        kind="SAC of Stable-Baselines3",
        hidden="actor.latent_pi.",
        head=("actor.mu",),
        ignored=("actor.log_std.", "critic.", "critic_target."),
        activation="relu",
        squashed=True,
    ),
    "stable_baselines3.td3.policies": _Family(
        kind="TD3 or DDPG of Stable-Baselines3",
        hidden="actor.mu.",
        head=(),
        ignored=("actor_target.", "critic.", "critic_target."),
        activation="relu",
        squashed=True,
    ),
}
"""Families by the module of the policy's class."""


def read_stable_baselines(path: Path, network: NetworkSettings) -> ReferencePolicy:
    """Read the policy of a zip, with the normalizer named by `network`: the zip does not name VecNormalize."""
    source = str(path)
    settings, weights = read_zip(path)
    family = _family(settings, source)
    layers = list(_layers(weights, family, source))
    sizes = layers[0].in_features, layers[-1].out_features
    for complaint in _unsupported(settings, sizes):
        raise ContractError(f"{path}: data: {complaint}")
    found = _activation(settings, family, network, source)
    clip = _clip(_part(settings, "action_space"), family)
    known: dict[str, Any] = {"action": {"clip": clip}} if clip else {}
    facts = PolicyFacts(kind=family.kind, observations=sizes[0], actions=sizes[1], known=known)
    activation = require_settings(facts, source, found, network.normalizer)
    mlp = build_mlp(layers, activation, *([nn.Tanh()] if family.squashed else []))
    file = network.normalizer_path(path)
    fields: dict[str, Any] = {"known": known, "files": (file,) if file else ()}
    if (normalizer := _normalizer(file, sizes[0])) is None:
        return trace_module(mlp, sizes[0], source, kind=family.kind, **fields)
    first, kind = _Normalize(normalizer), f"{family.kind} with VecNormalize"
    fields |= first.statistics
    return trace_module(nn.Sequential(first, mlp), sizes[0], source, kind=kind, **fields)


class _Normalize(Normalizer):
    """Normalizer in double precision with a single-precision result, as in Stable-Baselines3."""

    def __init__(self, normalizer: VecNormalize) -> None:
        super().__init__(torch.from_numpy(normalizer.mean), torch.from_numpy(normalizer.divisor))
        self.clip = normalizer.clip

    def forward(self, observation: Tensor) -> Tensor:
        """Return normalized observations (B, N)."""
        return super().forward(observation.double()).clamp(-self.clip, self.clip).float()


def _family(settings: Mapping[str, object], source: str) -> _Family:
    module = _part(settings, "policy_class").get("__module__")
    if isinstance(module, str) and module in FAMILIES:
        return FAMILIES[module]
    found = f"policy_class: found one of {module!r:.100}"
    raise ContractError(f"{source}: data: {found}, expected one of {', '.join(FAMILIES)}")


def _layers(weights: Mapping[str, Tensor], family: _Family, source: str) -> Iterator[nn.Linear]:
    count = next(k for k in itertools.count() if f"{family.hidden}{2 * k}.weight" not in weights)
    names = [*(f"{family.hidden}{2 * k}" for k in range(count)), *family.head]
    used = {f"{name}.{part}" for name in names for part in ("weight", "bias")}
    if unknown := [n for n in weights if n not in used and not n.startswith(family.ignored)]:
        raise ContractError(f"{source}: policy.pth: found tensor {unknown[0]!r:.100}, expected a plain MLP")
    if missing := sorted(used - weights.keys()) or [f"{family.hidden}0.weight"] * (not names):
        raise ContractError(f"{source}: policy.pth: found no tensor {missing[0]!r}, expected a plain MLP")
    width: int | None = None
    for name in names:
        layer = linear_layer(f"{name}.", weights, source)
        if width not in (None, layer.in_features):
            raise ContractError(f"{source}: {name}: found {layer.in_features} inputs, expected {width}")
        width = layer.out_features
        yield layer


def _unsupported(settings: Mapping[str, object], sizes: tuple[int, int]) -> Iterator[str]:
    """Yield unsupported settings, from the plain text only; pickled settings are not read."""
    extractor = _part(settings, "policy_kwargs").get("features_extractor_class", FLATTEN)
    if extractor != FLATTEN:
        yield f"features_extractor_class: found {extractor!r:.100}, expected {FLATTEN}"
    if settings.get("use_sde") is not False:
        yield f"use_sde: found {settings.get('use_sde')!r:.20}, expected False: gSDE is not imported"
    for name, size in zip(("observation_space", "action_space"), sizes, strict=True):
        space = _part(settings, name)
        kind, shape = str(space.get(":type:")), space.get("_shape")
        if not kind.endswith("spaces.box.Box'>") or shape != [size] or size > SIZE_MAX:
            yield f"{name}: found {kind:.100} {shape!r:.50}, expected a Box ({size},), {SIZE_MAX} at most"


def _activation(
    settings: Mapping[str, object], family: _Family, network: NetworkSettings, source: str
) -> Activation | None:
    if "policy_kwargs" not in settings:
        return network.activation
    names: dict[object, Activation] = {str(kind): name for name, kind in ACTIVATIONS.items()}
    text = _part(settings, "policy_kwargs").get("activation_fn", str(ACTIVATIONS[family.activation]))
    found = names.get(str(text))
    if found is None or network.activation not in (None, found):
        expected = network.activation or f"one of {', '.join(ACTIVATIONS)}"
        raise ContractError(f"{source}: data: activation_fn: found {text!r:.100}, expected {expected}")
    return found


def _clip(space: Mapping[str, object], family: _Family) -> list[float] | None:
    """Return the bounds of the action, if they are the same for all numbers."""
    if family.squashed:
        return [-1.0, 1.0]
    ends = [set(str(space.get(name)).strip("[]").split()) for name in ("low", "high")]
    try:
        bounds = [float(text) for texts in ends for text in texts]
    except ValueError:
        return None
    return bounds if [len(texts) for texts in ends] == [1, 1] and math.isfinite(sum(bounds)) else None


def _normalizer(path: Path | None, size: int) -> VecNormalize | None:
    normalizer = None if path is None else read_vec_normalize(path)
    if normalizer is not None and normalizer.mean.size != size:
        raise ContractError(f"{path}: found {normalizer.mean.size} numbers, expected {size} as in the policy")
    return normalizer


def _part(settings: Mapping[str, object], name: str) -> Mapping[str, object]:
    part = settings.get(name)
    return part if isinstance(part, dict) else {}
