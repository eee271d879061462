import pytest

gymnasium = pytest.importorskip("gymnasium")
pytest.importorskip("stable_baselines3")
pytest.importorskip("onnxscript")

import copy
import json
import os
import zipfile

import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

LOW, HIGH = np.array([-2, -1, 0], np.float32), np.array([2, 3, 1], np.float32)


class Tiny(gymnasium.Env):
    """Observations far from what a normalizer begins with."""

    def __init__(self, shape=(5,)):
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, shape, np.float32)
        self.action_space = gymnasium.spaces.Box(LOW, HIGH)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return self._observed(), {}

    def step(self, action):
        return self._observed(), 0.0, False, False, {}

    def _observed(self):
        shape = self.observation_space.shape
        spread = 0.1 + np.arange(np.prod(shape)).reshape(shape)
        return (self.np_random.normal(size=shape) * spread + 3).astype(np.float32)


def normalizing(environment=Tiny, **settings):
    """The library's wrapper after fifty steps."""
    wrapped = VecNormalize(DummyVecEnv([environment]), **settings)
    wrapped.seed(0)
    wrapped.reset()
    for _ in range(50):
        wrapped.step([LOW])
    return wrapped


def kept(wrapped, folder):
    wrapped.save(str(folder / "vecnormalize.pkl"))
    return folder / "vecnormalize.pkl"


class Command:
    """What a pickle of it would do: make a file."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return os.system, (f"touch {self.path}",)


SMALL = {"net_arch": [16, 8]}


def saved(folder, learner=PPO, environment=Tiny, exclude=None, **settings):
    """A model of the library, its wrapper, and where both lie."""
    wrapped = normalizing(environment)
    kept(wrapped, folder)
    settings = copy.deepcopy(settings)  # SAC writes into them
    model = learner(settings.pop("policy", "MlpPolicy"), wrapped, seed=0, device="cpu", **settings)
    for parameter in model.policy.parameters():  # as training would: no layer is nearly nothing
        parameter.data.mul_(1.5).add_(0.05)
    model.save(folder / "policy.zip", exclude=exclude)
    return model, wrapped, folder / "policy.zip"


def predicted(model, wrapped, observations):
    """What its owners get, before it is stretched to the action space."""
    action, _ = model.predict(wrapped.normalize_obs(observations), deterministic=True)
    return model.policy.scale_action(action) if model.policy.squash_output else action


def settings(path):
    with zipfile.ZipFile(path) as archive:
        return json.loads(archive.read("data"))
