import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("onnxscript")
tensordict = pytest.importorskip("tensordict")
models = pytest.importorskip("rsl_rl.models")

from support.contracts import NAMES

THEIRS = [NAMES[k] for k in (3, 0, 5, 1, 4, 2)]
N, A = 21, 6
CONTRACT = f"""
robot = "arm6"
task = "reach"
policy_hz = 50
joint_names = {THEIRS!r}

[[observation]]
name = "joint_pos"
source = "joint_position"
offset = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]
multiply = 1.0
clip = "none"
history = 1

[[observation]]
name = "joint_vel"
source = "joint_velocity"
offset = "none"
multiply = 0.05
clip = [-100.0, 100.0]
clip_first = false
history = 1

[[observation]]
name = "goal"
source = "goal_position"
offset = "none"
multiply = 1.0
clip = "none"
history = 1

[[observation]]
name = "actions"
source = "last_action"
offset = "none"
multiply = 1.0
clip = "none"
history = 1

[action]
mode = "position"
offset = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]
multiply = 0.5
clip = "none"
kp = "none"
kd = "none"
"""


def exported(folder, kind="mlp"):
    """What rsl_rl's own exporter writes: weights of an LSTM in a second file, a batch of one."""
    torch.manual_seed(0)
    shape = tensordict.TensorDict({"policy": torch.zeros(1, N)}, batch_size=[1])
    about = {"hidden_dims": (32, 16), "obs_normalization": True}
    if kind == "mlp":
        model = models.MLPModel(shape, {"actor": ["policy"]}, "actor", A, **about)
    else:
        about |= {"rnn_type": kind, "rnn_hidden_dim": 24, "rnn_num_layers": 2}
        model = models.RNNModel(shape, {"actor": ["policy"]}, "actor", A, **about)
    model.obs_normalizer.update(torch.randn(500, N) * 3 + 1)
    view, path = model.as_onnx(verbose=False).eval(), folder / f"{kind}.onnx"
    torch.onnx.export(
        view,
        view.get_dummy_inputs(),
        path,
        opset_version=18,
        input_names=view.input_names,
        output_names=view.output_names,
        verbose=False,
    )
    return path, view
