"""Checkpoints of rsl_rl: the actor that its runner saved, whichever version wrote it."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from torch import Tensor

from policies.importers.reference_policy import Facts, Original
from policies.importers.rsl_rl.actor import COUNT, read_actor
from policies.importers.torch_files.network_settings import Network
from policies.importers.torch_files.state_dict import answered, weights_of
from policies.importers.torch_files.traced_module import read_module
from policies.importers.untrusted.tensor_archive import load_tensors
from robots.errors import ContractError

ACTORS = ("actor_state_dict", "model_state_dict")
"""Since version 4; before it, when actor and critic were one model."""
NORMALIZER = "obs_norm_state_dict"
"""Before version 3, beside the model."""
OTHERS = {
    *("critic_state_dict", "optimizer_state_dict", "rnd_state_dict", "rnd_optimizer_state_dict"),
    *("privileged_obs_norm_state_dict", "critic_obs_norm_state_dict", "iter", "infos"),
}
"""What no actor needs; nor does it need these parts of a model."""
CRITIC = ("critic.", "memory_c.", "critic_obs_normalizer.")
RENAMED = {
    "actor_obs_normalizer.": "obs_normalizer.",
    "actor.": "mlp.",
    "memory_a.": "rnn.",
    "std": "distribution.std_param",
    "log_std": "distribution.log_std_param",
}
"""Parts before version 4, and spreads before version 5, as version 5 calls them."""


def read_rsl_rl(path: Path, network: Network) -> Original:
    """The mean of a Gaussian actor: an MLP, alone or behind an LSTM or a GRU, with or without a normalizer.

    Where rsl_rl is installed, its own classes play it.

    Raises:
        UnansweredError: its activation is not answered.
        ContractError: the file holds code, or an actor of another kind.
    """
    source = str(path)
    actor = read_actor(_weights(load_tensors(path, "expected a checkpoint of rsl_rl"), source), source)
    facts = Facts(kind=f"rsl_rl {actor.kind}", observations=actor.observations, actions=actor.actions)
    activation = answered(network, facts, source)
    if network.normalizer not in (None, "none"):
        found = f"network.normalizer: found {network.normalizer!r:.100}"
        raise ContractError(f"{source}: {found}, expected none: a checkpoint of rsl_rl has its own")
    original = read_module(actor.module(activation), facts.observations, source, kind=facts.kind)
    scaling = actor.scaling
    return replace(
        original,
        play=actor.play(activation) or original.play,
        mean=tuple(scaling.mean.tolist()) if scaling else None,
        deviation=tuple(scaling.divisor.tolist()) if scaling else None,
    )


def _weights(data: object, source: str) -> dict[str, Tensor]:
    """Of the actor alone, as version 5 names them."""
    if not isinstance(data, dict) or len(models := [name for name in ACTORS if name in data]) != 1:
        found = list(data) if isinstance(data, dict) else type(data).__name__
        raise ContractError(f"{source}: found {found!s:.300}, expected just one of {', '.join(ACTORS)}")
    for name in data:
        if name not in {*models, NORMALIZER, *OTHERS}:
            raise ContractError(f"{source}: {name!r:.100}: unknown, expected no more than rsl_rl writes")
    named: dict[str, object] = {}
    for prefix, key in (("", models[0]), ("obs_normalizer.", NORMALIZER)):
        for name, tensor in _items(data.get(key, {}), f"{source}: {key}"):
            if (new := prefix + _renamed(name)) in named:
                raise ContractError(f"{source}: {key}: {name!r:.100}: found {new!r:.100} twice")
            named[new] = tensor
    return weights_of({name: tensor for name, tensor in named.items() if name != COUNT}, source)


def _items(state: object, source: str) -> list[tuple[str, object]]:
    if not isinstance(state, Mapping):
        raise ContractError(f"{source}: found {type(state).__name__}, expected a state_dict")
    return [(str(name), tensor) for name, tensor in state.items() if not str(name).startswith(CRITIC)]


def _renamed(name: str) -> str:
    for old, new in RENAMED.items():
        if name == old or (old.endswith(".") and name.startswith(old)):
            return new + name[len(old) :]
    return name
