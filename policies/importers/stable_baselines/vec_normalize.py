"""The normalizer that Stable-Baselines3 keeps beside a policy, from its pickle, which is not run."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from deploy.policy.observation_terms import SIZE_MAX
from policies.importers.untrusted.pickle_reader import Inert, read_pickle
from robots.errors import ContractError

FILE_BYTES_MAX = 64 << 20
CLASS = "stable_baselines3.common.vec_env.vec_normalize VecNormalize"
STATISTICS = "stable_baselines3.common.running_mean_std RunningMeanStd"


@dataclass(frozen=True, slots=True, kw_only=True)
class VecNormalize:
    """clip((observation - mean) / divisor, ±clip), in double precision as Stable-Baselines3 computes it.

    Attributes:
        mean: (N,) of the observations in training. divisor: (N,) √(their variance + epsilon).
        clip: bound of what comes out.
    """

    mean: NDArray[np.float64]
    divisor: NDArray[np.float64]
    clip: float


def read_vec_normalize(path: Path) -> VecNormalize | None:
    """What `VecNormalize.save` wrote; None: it was told to leave observations as they are.

    Raises:
        ContractError: naming the file, the field, what was found and what was expected.
    """
    state = _state(read_pickle(_bytes(path), str(path)), CLASS, str(path))
    if not isinstance(normalizes := state.get("norm_obs"), bool):
        raise ContractError(f"{path}: norm_obs: found {_named(normalizes)}, expected true or false")
    if not normalizes:
        return None
    statistics = _state(state.get("obs_rms"), STATISTICS, f"{path}: obs_rms")
    mean, variance = (_vector(statistics.get(name), f"{path}: obs_rms.{name}") for name in ("mean", "var"))
    epsilon, clip = (_positive(state.get(name), f"{path}: {name}") for name in ("epsilon", "clip_obs"))
    if mean.shape != variance.shape or (variance < 0).any():
        raise ContractError(
            f"{path}: obs_rms.var: found {variance.size} numbers from {variance.min():g} on, expected"
            f" {mean.size} of 0 or more"
        )
    # No bound at all, infinity, is for single precision its largest number.
    clip = min(clip, float(np.finfo(np.float32).max))
    return VecNormalize(mean=mean, divisor=np.sqrt(variance + epsilon), clip=clip)


def _bytes(path: Path) -> bytes:
    try:
        with path.open("rb") as stream:
            data = stream.read(FILE_BYTES_MAX + 1)
    except OSError as e:
        raise ContractError(f"{path}: cannot be read: {e.strerror}, expected a file of VecNormalize") from e
    if len(data) > FILE_BYTES_MAX:
        raise ContractError(
            f"{path}: found more than {FILE_BYTES_MAX} bytes, expected a file of VecNormalize"
        )
    return data


def _state(value: object, kind: str, source: str) -> Mapping[str, object]:
    if isinstance(value, Inert) and value.callee == kind and isinstance(value.state, dict):
        return value.state
    raise ContractError(f"{source}: found {_named(value)}, expected {kind}; nothing of it was run")


def _vector(value: object, source: str) -> NDArray[np.float64]:
    """A vector of numpy, as pickles before protocol 5 and from it on hold one."""
    match value:
        case Inert(state=(_, (int(size),), dtype, _, bytes(raw))):
            width = _width(dtype)
        case Inert(arguments=(bytes(raw) | bytearray(raw), dtype, (int(size),), _)):
            width = _width(dtype)
        case _:
            size, width, raw = 0, 0, b""
    if not 0 < size <= SIZE_MAX or not width or len(raw) != size * width:
        raise ContractError(
            f"{source}: found {_named(value)}, expected a numpy vector of 1 to {SIZE_MAX} numbers, f4 or f8"
        )
    numbers = np.frombuffer(raw, f"<f{width}").astype(np.float64)
    if bad := int((~np.isfinite(numbers)).sum()):
        raise ContractError(f"{source}: found {bad} numbers NaN or infinite, expected all finite")
    return numbers


def _width(dtype: object) -> int:
    """Bytes of a floating-point number that begins with its least; 0: it is something else."""
    match dtype:
        case Inert(callee="numpy dtype", arguments=("f8" | "f4" as code, _, _), state=(_, "<", *_)):
            return int(code[1])
        case _:
            return 0


def _positive(value: object, source: str) -> float:
    if isinstance(value, (int, float)) and value > 0:
        return float(value)
    raise ContractError(f"{source}: found {_named(value)}, expected a number above 0")


def _named(value: object) -> str:
    """Never a whole that a stranger nested: only its kind."""
    if isinstance(value, Inert):
        return f"{value.callee!r:.100}" if isinstance(value.callee, str) else "a call of what another gave"
    return repr(value) if isinstance(value, (int, float, type(None))) else f"a {type(value).__name__}"
