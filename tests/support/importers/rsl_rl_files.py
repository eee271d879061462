import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("rsl_rl")
pytest.importorskip("onnxscript")

from rsl_rl.runners import OnPolicyRunner
from tensordict import TensorDict

N, A = 5, 2
RNN = {"class_name": "RNNModel", "rnn_hidden_dim": 6, "rnn_num_layers": 2}


class Env:
    """Noise, far from 0 and 1."""

    num_envs, num_actions, max_episode_length, device, cfg = 16, A, 20, "cpu", {}

    def get_observations(self):
        raw = torch.randn(16, N) * torch.tensor([0.1, 1, 3, 0.5, 10]) + torch.tensor([1.0, -2, 0, 0.3, 5])
        return TensorDict({"policy": raw}, batch_size=[16])


def saved(folder, activation="elu", distribution="GaussianDistribution", normalized=True, env=None, **actor):
    """What the runner of the installed rsl_rl saves, and its actor."""
    torch.manual_seed(0)
    network = {
        "class_name": "MLPModel",
        "hidden_dims": [8, 7],
        "activation": activation,
        "obs_normalization": normalized,
    }
    settings = {
        "num_steps_per_env": 8,
        "save_interval": 100,
        "obs_groups": {"actor": ["policy"], "critic": ["policy"]},
        "actor": {**network, **actor, "distribution_cfg": {"class_name": distribution}},
        "critic": dict(network),
        "algorithm": {"class_name": "PPO", "rnd_cfg": None, "symmetry_cfg": None},
    }
    env = env or Env()
    runner = OnPolicyRunner(env, settings, log_dir=None, device="cpu")
    for _ in range(3):
        runner.alg.get_policy().update_normalization(env.get_observations())
    path = folder / "model_0.pt"
    runner.save(str(path), {"note": "any"})
    return path, runner.get_inference_policy()


KINDS = {
    "MLP": {},
    "LSTM": {**RNN, "rnn_type": "lstm"},
    "GRU": {**RNN, "rnn_type": "gru", "normalized": False, "activation": "swish"},
}
