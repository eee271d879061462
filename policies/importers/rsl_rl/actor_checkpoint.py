"""Reader of checkpoints of rsl_rl, versions 2 to 5."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from torch import Tensor

from policies.importers.reference_policy import PolicyFacts, ReferencePolicy
from policies.importers.rsl_rl.actor import COUNT, read_actor
from policies.importers.torch_files.network_settings import NetworkSettings, require_settings
from policies.importers.torch_files.state_dict import check_weights
from policies.importers.torch_files.traced_module import trace_module
from policies.importers.untrusted.tensor_archive import load_tensors
from robots.errors import ContractError

ACTORS = ("actor_state_dict", "model_state_dict")
"""Key of the actor since version 4, and of the joint actor-critic model before."""
NORMALIZER = "obs_norm_state_dict"
"""Key of the normalizer before version 3."""
IGNORED_KEYS = {
    *("critic_state_dict", "optimizer_state_dict", "rnd_state_dict", "rnd_optimizer_state_dict"),
    *("privileged_obs_norm_state_dict", "critic_obs_norm_state_dict", "iter", "infos"),
}
"""Keys that the actor does not need."""
CRITIC = ("critic.", "memory_c.", "critic_obs_normalizer.")
RENAMED = {
    "actor_obs_normalizer.": "obs_normalizer.",
    "actor.": "mlp.",
    "memory_a.": "rnn.",
    "std": "distribution.std_param",
    "log_std": "distribution.log_std_param",
}
"""Prefixes before version 4 and standard deviations before version 5, with their names in version 5."""


def read_rsl_rl(path: Path, network: NetworkSettings) -> ReferencePolicy:
    """Read the mean of a Gaussian actor: an MLP with optional LSTM or GRU and optional normalizer.

    The reference is run by rsl_rl's own classes if it is installed; `network` must have the activation.
    """
    source = str(path)
    actor = read_actor(_weights(load_tensors(path, "expected a checkpoint of rsl_rl"), source), source)
    facts = PolicyFacts(kind=f"rsl_rl {actor.kind}", observations=actor.observations, actions=actor.actions)
    activation = require_settings(facts, source, network.activation)
    if network.normalizer not in (None, "none"):
        found = f"network.normalizer: found {network.normalizer!r:.100}"
        raise ContractError(f"{source}: {found}, expected no setting: the checkpoint has its own")
    module, statistics = actor.module(activation), actor.normalizer.statistics if actor.normalizer else {}
    reference = trace_module(module, facts.observations, source, kind=facts.kind, **statistics)
    return replace(reference, run=actor.runner(activation) or reference.run)


def _weights(data: object, source: str) -> dict[str, Tensor]:
    """Return the actor's weights, named as in version 5."""
    if not isinstance(data, dict) or len(models := [name for name in ACTORS if name in data]) != 1:
        found = list(data) if isinstance(data, dict) else type(data).__name__
        raise ContractError(f"{source}: found {found!s:.300}, expected exactly one of {', '.join(ACTORS)}")
    for name in data:
        if name not in {*models, NORMALIZER, *IGNORED_KEYS}:
            raise ContractError(f"{source}: {name!r:.100}: unknown, expected the keys of rsl_rl only")
    named: dict[str, object] = {}
    for prefix, key in (("", models[0]), ("obs_normalizer.", NORMALIZER)):
        for name, tensor in _items(data.get(key, {}), f"{source}: {key}"):
            if (new := prefix + _renamed(name)) in named:
                raise ContractError(f"{source}: {key}: {name!r:.100}: found {new!r:.100} twice")
            named[new] = tensor
    return check_weights({name: tensor for name, tensor in named.items() if name != COUNT}, source)


def _items(state: object, source: str) -> list[tuple[str, object]]:
    if not isinstance(state, Mapping):
        raise ContractError(f"{source}: found {type(state).__name__}, expected a state_dict")
    return [(str(name), tensor) for name, tensor in state.items() if not str(name).startswith(CRITIC)]


def _renamed(name: str) -> str:
    for old, new in RENAMED.items():
        if name == old or (old.endswith(".") and name.startswith(old)):
            return new + name[len(old) :]
    return name
