"""Reader of VecNormalize files of Stable-Baselines3; the pickle is parsed, not run."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from deploy.policy.contract_term import SIZE_MAX
from policies.importers.untrusted.pickle_reader import UnresolvedCall, read_pickle
from policies.importers.untrusted.zip_archive import read_bytes
from robots.errors import ContractError

FILE_BYTES_MAX = 64 << 20
EXPECTED = "expected a file of VecNormalize"
CLASS = "stable_baselines3.common.vec_env.vec_normalize VecNormalize"
STATISTICS = "stable_baselines3.common.running_mean_std RunningMeanStd"


@dataclass(frozen=True, slots=True, kw_only=True)
class VecNormalize:
    """clip((observation - mean) / divisor, ±clip), in double precision as in Stable-Baselines3.

    Attributes:
        mean: (N,) of the observations in training. divisor: (N,) √(variance + epsilon).
        clip: bound of the result.
    """

    mean: NDArray[np.float64]
    divisor: NDArray[np.float64]
    clip: float


def read_vec_normalize(path: Path) -> VecNormalize | None:
    """Read a file of `VecNormalize.save`; None if observations were not normalized."""
    state = _state(read_pickle(read_bytes(path, EXPECTED, FILE_BYTES_MAX), str(path)), CLASS, str(path))
    if not isinstance(normalizes := state.get("norm_obs"), bool):
        raise ContractError(f"{path}: norm_obs: found {_describe(normalizes)}, expected true or false")
    if not normalizes:
        return None
    statistics = _state(state.get("obs_rms"), STATISTICS, f"{path}: obs_rms")
    mean, variance = (_vector(statistics.get(name), f"{path}: obs_rms.{name}") for name in ("mean", "var"))
    epsilon, clip = (_positive(state.get(name), f"{path}: {name}") for name in ("epsilon", "clip_obs"))
    if mean.shape != variance.shape or (variance < 0).any():
        found = f"found {variance.size} numbers, smallest {variance.min():g}"
        raise ContractError(f"{path}: obs_rms.var: {found}, expected {mean.size} numbers >= 0")
    # An infinite bound is the largest number of single precision.
    clip = min(clip, float(np.finfo(np.float32).max))
    return VecNormalize(mean=mean, divisor=np.sqrt(variance + epsilon), clip=clip)


def _state(value: object, kind: str, source: str) -> Mapping[str, object]:
    if isinstance(value, UnresolvedCall) and value.callee == kind and isinstance(value.state, dict):
        return value.state
    raise ContractError(f"{source}: found {_describe(value)}, expected {kind}; nothing of it was run")


def _vector(value: object, source: str) -> NDArray[np.float64]:
    """Return a numpy vector, as pickled before protocol 5 or since."""
    match value:
        case UnresolvedCall(state=(_, (int(size),), dtype, _, bytes(raw))):
            width = _bytes_per_number(dtype)
        case UnresolvedCall(arguments=(bytes(raw) | bytearray(raw), dtype, (int(size),), _)):
            width = _bytes_per_number(dtype)
        case _:
            size, width, raw = 0, 0, b""
    if not 0 < size <= SIZE_MAX or not width or len(raw) != size * width:
        expected = f"expected a numpy vector of 1 to {SIZE_MAX} numbers, f4 or f8"
        raise ContractError(f"{source}: found {_describe(value)}, {expected}")
    numbers = np.frombuffer(raw, f"<f{width}").astype(np.float64)
    if bad := int((~np.isfinite(numbers)).sum()):
        raise ContractError(f"{source}: found {bad} numbers NaN or infinite, expected all finite")
    return numbers


def _bytes_per_number(dtype: object) -> int:
    """Return the bytes per number of a little-endian float type; 0 for another type."""
    match dtype:
        case UnresolvedCall(callee="numpy dtype", arguments=("f8" | "f4" as code, _, _), state=(_, "<", *_)):
            return int(code[1])
        case _:
            return 0


def _positive(value: object, source: str) -> float:
    if isinstance(value, (int, float)) and value > 0:
        return float(value)
    raise ContractError(f"{source}: found {_describe(value)}, expected a number above 0")


def _describe(value: object) -> str:
    """Describe a value by its kind; the value itself may be huge."""
    if isinstance(value, UnresolvedCall):
        return f"{value.callee!r:.100}" if isinstance(value.callee, str) else "a call of a computed function"
    return repr(value) if isinstance(value, (int, float, type(None))) else f"a {type(value).__name__}"
