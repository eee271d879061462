"""policy-import as its users run it: a library's own file, its template, filled in, imported, loaded, asked again."""

from functools import partial

import numpy as np
import pytest

torch = pytest.importorskip("torch")
tomlkit = pytest.importorskip("tomlkit")
pytest.importorskip("onnxscript")
pytest.importorskip("rsl_rl.models")

from torch import nn

from deploy.policy.policy import Policy
from policies.importers.cli import cli
from robots.strict import placeholder_fields
from support.arm6 import SPEC
from support.contracts import NAMES
from support.importers.exported_programs import saved as saved_program
from support.importers.imports import CONTRACT, THEIRS, A, N, exported
from support.importers.rsl_rl_files import KINDS as ACTORS
from support.importers.rsl_rl_files import Env
from support.importers.rsl_rl_files import saved as saved_checkpoint
from support.importers.torch_files import Recurrent, saved_script

pytestmark = pytest.mark.slow

STEPS = 40
ORDER = np.array([NAMES.index(name) for name in THEIRS])
COLUMNS = np.concatenate([ORDER, ORDER + 6, [12, 13, 14], ORDER + 15])
"""Where the numbers of the contract's terms stand in ours."""


class ArmEnv(Env):
    """Noise for the arm's policy."""

    num_actions = A

    def get_observations(self):
        observations = super().get_observations()
        spread = torch.linspace(0.1, 3, N)
        observations["policy"] = torch.randn(16, N) * spread + 1
        return observations


def asked(module):
    """Its answers to one observation after the other, from its beginning."""

    def owner(observations):
        with torch.no_grad():
            return np.concatenate([module(torch.from_numpy(row[None])).numpy() for row in observations])

    return owner


def network(hidden=16):
    torch.manual_seed(0)
    return nn.Sequential(nn.Linear(N, hidden), nn.ELU(), nn.Linear(hidden, A)).eval()


def checkpoint(folder, kind):
    path, model = saved_checkpoint(folder, env=ArmEnv(), **ACTORS[kind])
    model.reset()
    return path, asked(lambda row: model({"policy": row})), {"activation": "elu"}


def stable_baselines(folder):
    stable = pytest.importorskip("support.importers.stable_baselines")
    from gymnasium import spaces

    class Arm(stable.Tiny):
        def __init__(self):
            super().__init__((N,))
            self.action_space = spaces.Box(-0.5, 0.5, (A,))

    model, wrapped, path = stable.saved(folder, environment=Arm, policy_kwargs=stable.SMALL)
    return path, lambda rows: stable.predicted(model, wrapped, rows), {"normalizer": "vecnormalize.pkl"}


def torchscript(folder):
    torch.manual_seed(1)
    module = Recurrent(N, A).eval()
    return saved_script(folder / "motion.pt", module), asked(module), {}


def program(folder):
    torch.manual_seed(2)
    any_batch = {"dynamic_shapes": ({0: torch.export.Dim("batch", min=1, max=4096)},)}
    module = network()
    return saved_program(folder, module, batch=2, observations=N, **any_batch), asked(module), {}


def weights(folder):
    module = network()
    torch.save(module.state_dict(), folder / "weights.pt")
    statistics = {"mean": [1.0] * N, "std": [2.0] * N}
    owner = asked(lambda row: module((row - 1) / 2))
    return folder / "weights.pt", owner, {"activation": "elu", "normalizer": statistics}


def isaac_lab(folder, kind):
    path, view = exported(folder, kind)
    known = [torch.zeros_like(piece) for piece in view.get_dummy_inputs()[1:]]

    def step(row):
        said = view(row, *known)
        action, *known[:] = said if isinstance(said, tuple) else (said,)
        return action

    return path, asked(step), {}


FILES = {
    "rsl_rl MLP": lambda folder: checkpoint(folder, "MLP"),
    "rsl_rl LSTM": lambda folder: checkpoint(folder, "LSTM"),
    "Stable-Baselines3": stable_baselines,
    "TorchScript": torchscript,
    "torch.export": program,
    "state_dict": weights,
    "Isaac Lab MLP": lambda folder: isaac_lab(folder, "mlp"),
    "Isaac Lab GRU": lambda folder: isaac_lab(folder, "gru"),
}


@pytest.fixture
def run(call):
    return partial(call, cli)


def fill_in(draft, answers):
    """What its owner writes where the template asks; what the template says already stays."""
    document, contract = tomlkit.parse(draft.read_text()), tomlkit.parse(CONTRACT)
    asked_for = set(placeholder_fields(document.unwrap()))
    assert asked_for >= {"robot", "task", "policy_hz", "joint_names", "action.mode", "action.offset"}
    for key in ("robot", "task", "policy_hz", "joint_names", "observation"):
        document[key] = contract[key]
    for key in [key for key in document["action"] if document["action"][key] == "?"]:
        document["action"][key] = contract["action"][key]
    assert set(answers) == {field.partition(".")[2] for field in asked_for if field.startswith("network.")}
    for key, answer in answers.items():
        document["network"][key] = answer
    draft.write_text(tomlkit.dumps(document))


@pytest.mark.parametrize("kind", FILES)
def test_library_file_becomes_an_equal_policy(kind, tmp_path, run):
    path, owner, answers = FILES[kind](tmp_path)
    draft, out = path.with_suffix(".toml"), tmp_path / "out" / "mine.onnx"
    code, said, _ = run(path, "--template")
    assert code == 0
    assert said.startswith(f"{draft}: ")
    assert f"{N} observations, {A} actions; " in said
    code, _, complaint = run(path, "--out", out)
    assert code == 2
    assert f"error: {draft}: robot: still '?', to be filled in\n" in complaint
    assert not out.exists()

    fill_in(draft, answers)
    code, said, _ = run(path, "--out", out)
    assert code == 0
    assert said.startswith(f"{out}: ")
    assert "agrees with the original on 1,024 observations and 16 sequences of 200" in said

    policy = Policy.load(out, SPEC)
    theirs = (np.random.default_rng(0).normal(size=(STEPS, N)) * 2 + 1).astype(np.float32)
    ours = np.empty_like(theirs)
    ours[:, COLUMNS] = theirs
    found = policy.rehearse(ours, 1)[:, 0, ORDER].clip(*policy.contract.action.bounds)
    expected = owner(theirs)
    assert np.ptp(expected, axis=0).min() > 0.01
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-5 * max(1, np.abs(expected).max()))
