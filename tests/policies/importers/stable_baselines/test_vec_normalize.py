import pickle
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from policies.importers.stable_baselines.vec_normalize import read_vec_normalize
from policies.importers.untrusted.pickle_reader import OPCODES_MAX, UnresolvedCall, read_pickle
from support.importers.stable_baselines import Command, Tiny, kept, normalizing
from support.refusals import refusal

gymnasium = pytest.importorskip("gymnasium")
pytest.importorskip("stable_baselines3")


refused = partial(refusal, read_vec_normalize)


def spoiled(folder, **state):
    """A file of the library in which the wrapper's attributes say something else."""
    wrapped = normalizing()
    vars(wrapped).update(state)
    return kept(wrapped, folder)


def test_normalization_equals_the_library_bit_for_bit(tmp_path):
    wrapped = normalizing(clip_obs=1.5, epsilon=1e-3)
    found = read_vec_normalize(kept(wrapped, tmp_path))
    observation = np.random.default_rng(0).normal(3, 4, (300, 5)).astype(np.float32)
    ours = ((observation - found.mean) / found.divisor).clip(-found.clip, found.clip).astype(np.float32)
    np.testing.assert_array_equal(ours, wrapped.normalize_obs(observation))
    assert (np.abs(ours) == 1.5).any()
    assert (np.abs(ours) < 1.5).any()


@pytest.mark.parametrize("protocol", range(3, pickle.HIGHEST_PROTOCOL + 1))
def test_every_protocol_of_the_library_s_pythons_reads_the_same(tmp_path, protocol):
    wrapped = normalizing()
    path = tmp_path / "x.pkl"
    path.write_bytes(pickle.dumps(wrapped, protocol))
    np.testing.assert_array_equal(read_vec_normalize(path).mean, wrapped.obs_rms.mean)


def test_normalizer_without_observations_is_none(tmp_path):
    assert read_vec_normalize(kept(normalizing(norm_obs=False), tmp_path)) is None


def test_infinite_clip_is_the_largest_single_precision_number(tmp_path):
    assert read_vec_normalize(kept(normalizing(clip_obs=np.inf), tmp_path)).clip == np.finfo(np.float32).max


def test_code_is_not_run(tmp_path):
    sign, path = tmp_path / "sign", tmp_path / "x.pkl"
    path.write_bytes(pickle.dumps(Command(sign)))
    assert "posix system" in refused(path)
    assert "nothing of it was run" in refused(path)
    assert not sign.exists()
    pickle.loads(path.read_bytes())  # the file would have done it
    assert sign.exists()


def test_code_in_unused_fields_is_not_run(tmp_path):
    path = spoiled(tmp_path, metadata={"render_modes": Command(tmp_path / "sign")})
    assert read_vec_normalize(path).mean.size == 5
    assert not (tmp_path / "sign").exists()


@pytest.mark.parametrize("field", ["obs_rms", "norm_obs", "epsilon", "clip_obs"])
def test_code_in_place_of_a_number_is_refused_and_not_run(tmp_path, field):
    path = spoiled(tmp_path, **{field: Command(tmp_path / "sign")})
    assert refused(path).startswith(f"{field}: found 'posix system', expected")
    assert not (tmp_path / "sign").exists()


def test_dict_observations_are_refused_by_name(tmp_path):
    class Named(Tiny):
        def __init__(self):
            super().__init__()
            self.observation_space = gymnasium.spaces.Dict({"joints": self.observation_space})

        def _observed(self):
            return {"joints": np.zeros(5, np.float32)}

    assert refused(kept(normalizing(Named), tmp_path)).startswith("obs_rms: found a dict, expected")


def test_observations_of_more_than_one_dimension_are_refused(tmp_path):
    path = kept(normalizing(lambda: Tiny((2, 3))), tmp_path)
    assert "obs_rms.mean: " in refused(path)
    assert "numpy vector" in refused(path)


@pytest.mark.parametrize(
    ("name", "value", "complaint"),
    [
        ("mean", np.full(5, np.nan), "obs_rms.mean: found 5 numbers NaN or infinite"),
        ("mean", np.zeros(4), "obs_rms.var: found 5 numbers"),
        ("mean", np.zeros(5, np.int64), "obs_rms.mean: found"),
        ("mean", np.zeros(5000), "obs_rms.mean: found"),
        ("mean", None, "obs_rms.mean: found None"),
        ("var", np.full(5, -1.0), "obs_rms.var: found 5 numbers, smallest -1"),
    ],
)
def test_invalid_statistics_are_refused(tmp_path, name, value, complaint):
    wrapped = normalizing()
    setattr(wrapped.obs_rms, name, value)
    assert refused(kept(wrapped, tmp_path)).startswith(complaint)


@pytest.mark.parametrize(("field", "value"), [("epsilon", 0.0), ("clip_obs", -1), ("clip_obs", "10")])
def test_invalid_settings_are_refused(tmp_path, field, value):
    assert refused(spoiled(tmp_path, **{field: value})).startswith(f"{field}: found")


def test_foreign_files_are_refused_in_one_line(tmp_path, monkeypatch):
    path = tmp_path / "x.pkl"
    assert refused(path).startswith("cannot be read: ")
    for content in (b"", b"no pickle", b"\x80\x04.", b"((((.", b"\x80\x04\x8c\xffshort"):
        path.write_bytes(content)
        assert refused(path).startswith("found no pickle that can be read")
    path.write_bytes(pickle.dumps({"norm_obs": True}))
    assert refused(path).startswith("found a dict, expected")
    path.write_bytes(b"(" * (OPCODES_MAX + 1) + b".")
    assert refused(path).startswith(f"found more than {OPCODES_MAX} steps")
    monkeypatch.setattr("policies.importers.stable_baselines.vec_normalize.FILE_BYTES_MAX", 1000)
    assert refused(path).endswith("bytes, at most 1000, expected a file of VecNormalize")


def test_excessive_pickles_are_neither_run_nor_printed(tmp_path):
    nested = b")" + b"\x94h\x00\x86" + b"".join(bytes([0x94, 0x68, k, 0x86]) for k in range(1, 90))
    path = tmp_path / "x.pkl"
    for content in (b"\x80\x04}" + nested + b"Ns.", b"\x80\x04" + nested + b".", b"Nr\xff\xff\xff\xff."):
        path.write_bytes(content)
        assert "found " in refused(path)


def test_plain_values_are_read_and_calls_are_recorded():
    value = {"a": (1, 2.5, None, True), "b": b"raw", "c": "text", "d": {"e": -1}}
    assert read_pickle(pickle.dumps(value), "x") == value
    note = read_pickle(pickle.dumps(Path("a")), "x")
    assert isinstance(note, UnresolvedCall)
    assert note.callee.startswith("pathlib")
