import io
import json
import zipfile

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("onnxscript")
pytest.importorskip("stable_baselines3")

from gymnasium import spaces
from stable_baselines3 import A2C, DDPG, PPO, SAC, TD3

from policies.importers.reference_policy import MissingSettingError
from policies.importers.stable_baselines.policy import read_stable_baselines
from policies.importers.torch_files.network_settings import NetworkSettings, NormalizerStatistics
from robots.errors import ContractError
from support.importers.parity import parity
from support.importers.stable_baselines import (
    HIGH,
    LOW,
    SMALL,
    Command,
    Tiny,
    kept,
    normalizing,
    predicted,
    saved,
    settings,
)

pytestmark = pytest.mark.slow

NONE = NetworkSettings(normalizer="none")
NORMALIZED = NetworkSettings(normalizer="vecnormalize.pkl")


def played(original, count=300):
    observations = np.random.default_rng(0).normal(3, 4, (count, 5)).astype(np.float32)
    return observations, original.run(observations, np.zeros(count, bool))


def refused(path, network=NONE):
    with pytest.raises(ContractError) as caught:
        read_stable_baselines(path, network)
    assert "\n" not in str(caught.value)
    assert not isinstance(caught.value, MissingSettingError)
    return str(caught.value).removeprefix(f"{path}: ")


def asked(path, network):
    with pytest.raises(MissingSettingError) as caught:
        read_stable_baselines(path, network)
    return caught.value.facts.known["network"]


def rewritten(path, compression=zipfile.ZIP_STORED, without=(), **members):
    """The same zip with other members."""
    with zipfile.ZipFile(path) as archive:
        content = {name: archive.read(name) for name in archive.namelist() if name not in without}
    with zipfile.ZipFile(path, "w", compression) as archive:
        for name, data in (
            content | {name.replace("_pth", ".pth"): data for name, data in members.items()}
        ).items():
            archive.writestr(name, data)
    return path


def weights(path):
    with zipfile.ZipFile(path) as archive:
        return torch.load(io.BytesIO(archive.read("policy.pth")), weights_only=True)


def with_weights(path, tensors):
    stream = io.BytesIO()
    torch.save(tensors, stream)
    return rewritten(path, policy_pth=stream.getvalue())


@pytest.mark.parametrize(
    ("learner", "kwargs"),
    [
        (PPO, SMALL),
        (SAC, SMALL),
        (TD3, SMALL),
        (A2C, {"activation_fn": torch.nn.ELU, "net_arch": {"pi": [8], "vf": [4, 4]}}),
        (DDPG, {"activation_fn": torch.nn.SiLU, "net_arch": []}),
    ],
)
def test_original_and_imported_file_equal_predict(tmp_path, learner, kwargs):
    model, wrapped, path = saved(tmp_path, learner, policy_kwargs=kwargs)
    original = read_stable_baselines(path, NORMALIZED)
    observations, found = played(original)
    expected = predicted(model, wrapped, observations)
    if not model.policy.squash_output:
        assert (found != np.clip(found, LOW, HIGH)).any()
        found = np.clip(found, LOW, HIGH)
    np.testing.assert_allclose(found, expected, rtol=0, atol=2e-6)
    assert np.ptp(expected, axis=0).min() > 0.1
    assert parity(original) <= 1e-5


@pytest.fixture(scope="module")
def ppo(tmp_path_factory):
    """One with all that the library does unasked."""
    return saved(tmp_path_factory.mktemp("ppo"))


def test_normalizer_matters(ppo):
    *_, path = ppo
    observations, bare = played(read_stable_baselines(path, NONE))
    normalized = read_stable_baselines(path, NORMALIZED)
    assert np.abs(bare - normalized.run(observations, np.zeros(300, bool))).max() > 0.1
    lost = read_stable_baselines(path, NONE)
    object.__setattr__(normalized, "model", lost.model)
    with pytest.raises(ContractError, match="weights or a normalizer differ"):
        parity(normalized)


def test_normalizer_gives_the_training_statistics(ppo):
    _, wrapped, path = ppo
    original = read_stable_baselines(path, NORMALIZED)
    np.testing.assert_array_equal(original.mean, wrapped.obs_rms.mean)
    np.testing.assert_allclose(original.deviation, np.sqrt(wrapped.obs_rms.var), rtol=1e-6)
    assert original.facts.kind == "PPO or A2C of Stable-Baselines3 with VecNormalize"


def test_missing_facts_are_required(tmp_path, ppo):
    *_, path = ppo
    assert asked(path, NetworkSettings()) == {"normalizer": "?"}
    *_, path = saved(tmp_path, policy_kwargs=SMALL, exclude=["policy_kwargs"])
    assert asked(path, NetworkSettings()) == {"activation": "?", "normalizer": "?"}
    assert asked(path, NONE) == {"activation": "?"}
    answer = NetworkSettings(activation="tanh", normalizer="none")
    assert read_stable_baselines(path, answer).facts.observations == 5


def test_bounds_of_the_action_are_known_where_they_are_one_pair(tmp_path, ppo):
    def known(path):
        with pytest.raises(MissingSettingError) as caught:
            read_stable_baselines(path, NetworkSettings())
        return caught.value.facts.known.get("action")

    assert known(ppo[2]) is None

    class Even(Tiny):
        def __init__(self):
            super().__init__()
            self.action_space = spaces.Box(-1.5, 1.5, (3,))

    assert known(saved(tmp_path, environment=Even)[2]) == {"clip": [-1.5, 1.5]}
    assert known(saved(tmp_path, SAC, policy_kwargs=SMALL)[2]) == {"clip": [-1.0, 1.0]}


def test_contradicting_answer_is_refused(ppo):
    message = refused(ppo[2], NetworkSettings(activation="relu", normalizer="none"))
    assert message.startswith("data: activation_fn: found \"<class 'torch.nn.modules.activation.Tanh'>\"")
    assert message.endswith("expected relu")


def test_unknown_activation_is_refused(tmp_path):
    *_, path = saved(tmp_path, policy_kwargs=SMALL | {"activation_fn": torch.nn.Mish})
    assert "activation_fn: found \"<class 'torch.nn.modules.activation.Mish'>\"" in refused(path)
    assert "activation_fn" in refused(path, NetworkSettings(activation="relu", normalizer="none"))


def test_other_kinds_of_policy_are_refused_by_name(tmp_path):
    from stable_baselines3.common.policies import ActorCriticPolicy
    from stable_baselines3.common.torch_layers import FlattenExtractor

    class Doubled(FlattenExtractor):
        def forward(self, observations):
            return 2 * super().forward(observations)

    class Own(ActorCriticPolicy):
        pass

    class Named(Tiny):
        def __init__(self):
            super().__init__()
            self.observation_space = spaces.Dict({"joints": self.observation_space})

        def _observed(self):
            return {"joints": np.zeros(5, np.float32)}

    class Square(Tiny):
        def __init__(self):
            super().__init__((2, 3))

    kwargs = {"policy_kwargs": {"features_extractor_class": Doubled}}
    assert "features_extractor_class: found" in refused(saved(tmp_path, **kwargs)[2])
    assert f"policy_class: found one of {__name__!r}" in refused(saved(tmp_path, policy=Own)[2])
    assert "use_sde: found True" in refused(saved(tmp_path, use_sde=True)[2])
    assert "spaces.dict.Dict" in refused(saved(tmp_path, environment=Named, policy="MultiInputPolicy")[2])
    assert "[2, 3], expected a Box (6,)" in refused(saved(tmp_path, environment=Square)[2])


def test_other_tensors_than_those_of_an_mlp_are_refused(ppo, tmp_path):
    path = tmp_path / "policy.zip"

    def spoiled(**changed):
        path.write_bytes(ppo[2].read_bytes())
        tensors = weights(path) | {name.replace("__", "."): tensor for name, tensor in changed.items()}
        return refused(with_weights(path, {k: v for k, v in tensors.items() if v is not None}))

    assert "found tensor 'features_extractor.cnn.0.weight'" in spoiled(
        features_extractor__cnn__0__weight=torch.zeros(8, 3, 3, 3)
    )
    assert "found no tensor 'action_net.bias'" in spoiled(action_net__bias=None)
    assert "found 3 values NaN or infinite" in spoiled(action_net__bias=torch.full((3,), torch.nan))
    assert "action_net: found 63 inputs, expected 64" in spoiled(action_net__weight=torch.zeros(3, 63))
    assert "found torch.float16" in spoiled(action_net__weight=torch.zeros(3, 64).half())
    assert "found torch.float32 (3, 64)" in spoiled(action_net__weight=torch.zeros(1).expand(3, 64))


def test_code_is_not_run(ppo, tmp_path):
    path, sign = tmp_path / "policy.zip", tmp_path / "sign"
    path.write_bytes(ppo[2].read_bytes())
    with_weights(path, weights(path) | {"action_net.bias": Command(sign)})
    assert "policy.pth: data.pkl: found 'posix.system'" in refused(path)
    assert not sign.exists()


def test_pickles_among_the_settings_are_not_run(ppo, tmp_path):
    import base64
    import pickle

    path, sign = tmp_path / "policy.zip", tmp_path / "sign"
    path.write_bytes(ppo[2].read_bytes())
    data = settings(path)
    bad = base64.b64encode(pickle.dumps(Command(sign))).decode()
    for part in data.values():
        if isinstance(part, dict) and ":serialized:" in part:
            part[":serialized:"] = bad
    read_stable_baselines(rewritten(path, data=json.dumps(data)), NONE)
    assert not sign.exists()


def test_bombs_are_not_unpacked(ppo, tmp_path, monkeypatch):
    path = tmp_path / "policy.zip"
    path.write_bytes(ppo[2].read_bytes())
    monkeypatch.setattr("policies.importers.untrusted.zip_archive.BYTES_MAX", 10**6)
    zeros = bytes(10**6 + 1)
    assert "bytes unpacked, expected at most 1000000" in refused(
        rewritten(path, zipfile.ZIP_DEFLATED, policy_pth=zeros)
    )
    inner = io.BytesIO()
    with zipfile.ZipFile(inner, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("archive/data.pkl", zeros)
    assert refused(rewritten(path, policy_pth=inner.getvalue())).startswith("policy.pth: found 1000001 bytes")
    assert "found compression 12" in refused(rewritten(path, zipfile.ZIP_BZIP2))


def test_foreign_files_are_refused_in_one_line(ppo, tmp_path):
    path = tmp_path / "policy.zip"
    assert refused(path).startswith("cannot be read: ")
    path.write_bytes(b"no zip")
    assert refused(path).startswith(
        "found no archive that can be read: a BadZipFile, expected a zip of Stable"
    )
    path.write_bytes(ppo[2].read_bytes()[:1000])
    assert refused(path).startswith(
        "found no archive that can be read: a BadZipFile, expected a zip of Stable"
    )
    for name in ("data", "policy.pth"):
        path.write_bytes(ppo[2].read_bytes())
        assert refused(rewritten(path, without=(name,))).startswith(f"found no '{name}' in it")
    for data in ("no json", "[]", "\xff", "{}"):
        path.write_bytes(ppo[2].read_bytes())
        assert refused(rewritten(path, data=data.encode("latin-1"))).startswith("data: ")


def test_missing_or_mismatched_normalizer_is_refused(ppo, tmp_path):
    path = tmp_path / "policy.zip"
    path.write_bytes(ppo[2].read_bytes())
    assert "vecnormalize.pkl: cannot be read" in refused(path, NORMALIZED)
    numbers = NetworkSettings(normalizer=NormalizerStatistics(mean=(0.0,) * 5, std=(1.0,) * 5))
    assert (
        refused(path, numbers) == "network.normalizer: found numbers, expected the path of a file, or 'none'"
    )
    kept(normalizing(lambda: Tiny((4,))), tmp_path)
    assert "vecnormalize.pkl: found 4 numbers, expected 5" in refused(path, NORMALIZED)


@pytest.mark.parametrize("normalizes", [True, False])
def test_the_file_of_the_normalizer_is_reported(ppo, tmp_path, normalizes):
    """So that it is not written over; also if it says that observations are not normalized."""
    path = tmp_path / "policy.zip"
    path.write_bytes(ppo[2].read_bytes())
    wrapped = normalizing(lambda: Tiny((5,)))
    wrapped.norm_obs = normalizes
    kept(wrapped, tmp_path)
    assert read_stable_baselines(path, NORMALIZED).files == (tmp_path / "vecnormalize.pkl",)
    assert read_stable_baselines(path, NONE).files == ()
