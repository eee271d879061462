import json
import os
import tempfile
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("onnxscript")

from onnx import numpy_helper

from deploy.policy.contract import Observed
from deploy.policy.policy import Policy
from deploy.policy.policy_names import CONTRACT_KEY, GOLDEN_KEY
from deploy.start import LACKING
from policies.export.cli import POLICIES, cli, export, find_checkpoint, policy_export
from policies.training.checkpoint import load_checkpoint
from robots.errors import ContractError, OutputError, RobotError
from support.arm6 import SPEC, copy_of_arm
from support.checkpoints import made_actor, saved
from support.contracts import SWAPPED, arm_contract

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """A checkpoint and what was exported from it."""
    folder = tmp_path_factory.mktemp("export")
    checkpoint = saved(folder)
    return checkpoint, export(checkpoint, folder / "new" / "arm.onnx")


def test_no_temporary_folder_is_one_line(done, call, tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", None)
    monkeypatch.setattr(tempfile, "_candidate_tempdir_list", lambda: ["/nowhere"])
    code, _, said = call(cli, "--policy", done[0], "--out", tmp_path / "a.onnx")
    assert (code, said) == (
        LACKING,
        "error: a temporary file: No usable temporary directory found in ['/nowhere']\n",
    )


def test_the_file_agrees_with_torch_on_other_observations(done):
    checkpoint, exported = done
    policy = Policy.load(exported.path, SPEC)
    actor = load_checkpoint(checkpoint).actor
    observation = torch.randn(2000, 30, generator=torch.Generator().manual_seed(1))
    for batch in (1, 7, 64):
        found = policy.replay(observation.numpy(), batch)
        np.testing.assert_allclose(found, actor(observation).numpy(), rtol=0, atol=1e-5)


def test_summary_matches_the_file(done):
    _, exported = done
    assert exported.file_bytes == exported.path.stat().st_size
    assert exported.digest == Policy.load(exported.path, SPEC).digest
    assert exported.observations == 1100
    assert len(exported.deviation) == 2
    assert 0 < max(exported.deviation) <= 1e-5


def test_the_normalizer_is_in_the_graph(done):
    checkpoint, exported = done
    actor = load_checkpoint(checkpoint).actor
    raw = onnxruntime.InferenceSession(exported.path, providers=["CPUExecutionProvider"])
    mean = actor.mean.numpy()[None]
    found = raw.run(None, {"observation": mean})[0]
    np.testing.assert_allclose(found, actor.mlp(torch.zeros(1, 30)).numpy(), rtol=0, atol=1e-5)


def test_the_metadata_are_the_contract_and_spread_golden_pairs(done):
    checkpoint, exported = done
    metadata = {entry.key: entry.value for entry in onnx.load(exported.path).metadata_props}
    assert sorted(metadata) == [CONTRACT_KEY, GOLDEN_KEY]
    actor = load_checkpoint(checkpoint).actor
    observed = Observed(mean=tuple(actor.mean.tolist()), deviation=tuple(actor.divisor.tolist()))
    assert metadata[CONTRACT_KEY] == arm_contract(observed=observed).to_json()
    golden = {key: np.array(rows, np.float32) for key, rows in json.loads(metadata[GOLDEN_KEY]).items()}
    made = load_checkpoint(checkpoint)
    rows = [round(i * 1099 / 15) for i in range(16)]
    assert golden["observation"].tobytes() == made.rollout[rows].numpy().tobytes()
    np.testing.assert_allclose(golden["action"], made.actor(made.rollout[rows]).numpy(), rtol=0, atol=1e-6)


def test_one_file_with_no_trace_of_the_machine(done):
    _, exported = done
    assert os.listdir(exported.path.parent) == ["arm.onnx"]
    data = exported.path.read_bytes()
    for trace in (
        str(Path(torch.__file__).parents[1]),
        str(POLICIES.parent),
        str(Path.home()),
        ".py",
        "torch.nn",
    ):
        assert trace.encode() not in data
    model = onnx.load(exported.path)
    onnx.checker.check_model(model, full_check=True)
    assert [(opset.domain, opset.version) for opset in model.opset_import] == [("", 18)]


def test_weights_equal_the_checkpoint(done):
    checkpoint, exported = done
    tensors = {t.name: numpy_helper.to_array(t) for t in onnx.load(exported.path).graph.initializer}
    for name, tensor in load_checkpoint(checkpoint).actor.state_dict().items():
        assert tensors[name].tobytes() == tensor.numpy().tobytes()


def test_the_same_checkpoint_gives_the_same_bytes(done, tmp_path):
    checkpoint, exported = done
    out = tmp_path / "again.onnx"
    out.write_text("an older export")
    assert export(checkpoint, out).digest == exported.digest
    assert out.read_bytes() == exported.path.read_bytes()
    assert os.listdir(tmp_path) == ["again.onnx"]


def test_disagreeing_file_is_not_written(tmp_path):
    actor = made_actor()
    with torch.no_grad():
        actor.mlp[-1].weight *= 1e6  # rounding alone now exceeds the bound
    out = tmp_path / "arm.onnx"
    out.write_text("an older export")
    checkpoint = saved(tmp_path, actor=actor)
    with pytest.raises(ContractError) as caught:
        export(checkpoint, out)
    assert str(caught.value).startswith(f"{out} (not written): golden pairs: found a deviation of ")
    assert out.read_text() == "an older export"
    assert sorted(os.listdir(tmp_path)) == ["arm.onnx", "arm.pt"]


def test_every_row_of_the_rollout_is_compared(tmp_path):
    checkpoint = saved(tmp_path, spread=1e38)  # row 5 is no golden pair, and its action no number
    with pytest.raises(ContractError) as caught:
        export(checkpoint, tmp_path / "arm.onnx")
    assert str(caught.value).startswith(f"{checkpoint}: rollout row 5: ONNX Runtime and torch differ: found ")
    assert str(caught.value).endswith(" at batch 1, expected at most 1e-05")
    assert os.listdir(tmp_path) == ["arm.pt"]


# ---- refused before anything is traced ----


def misfit(**changes):
    return lambda folder: saved(folder, contract=arm_contract(**changes))


def corrupt(folder):
    path = saved(folder)
    path.write_bytes(path.read_bytes()[:-100])
    return path


REFUSED = {
    "corrupt": (corrupt, ContractError, "arm.pt: found no archive that can be read: a BadZipFile"),
    "missing": (
        lambda folder: folder / "no.pt",
        ContractError,
        "no.pt: cannot be read: No such file or directory",
    ),
    "unknown robot": (
        misfit(robot="hexapod"),
        RobotError,
        "--robot hexapod: no such folder with a robot.toml",
    ),
    "digest": (
        misfit(robot_digest="0" * 64),
        ContractError,
        f"contract: robot_digest: found {'0' * 64}, expected",
    ),
    "rate": (misfit(control_hz=500), ContractError, "contract: control_hz: found 500 Hz, expected 200 Hz"),
    "permuted": (
        misfit(joint_names=SWAPPED),
        ContractError,
        "joint_names: the right joints in another order",
    ),
}


@pytest.mark.parametrize(("make", "error", "message"), REFUSED.values(), ids=REFUSED)
def test_nothing_is_overwritten_by_a_bad_checkpoint(tmp_path, make, error, message):
    out = tmp_path / "kept.onnx"
    out.write_text("an older export")
    with pytest.raises(error) as caught:
        export(make(tmp_path), out)
    assert message in str(caught.value)
    assert out.read_text() == "an older export"
    assert not [path for path in tmp_path.iterdir() if path.name not in ("kept.onnx", "arm.pt")]


def test_an_unwritable_out_is_named(tmp_path):
    (tmp_path / "file").write_text("in the way")
    (tmp_path / "folder").mkdir()
    checkpoint = saved(tmp_path)
    for out, why in (
        (tmp_path / "file" / "arm.onnx", "cannot be written: Not a directory"),
        (tmp_path / "folder", "found a folder or a device, expected a file or nothing"),
        (Path("/dev/null"), "found a folder or a device, expected a file or nothing"),
        (tmp_path / ("x" * 300), "cannot be written: File name too long"),
    ):
        with pytest.raises(OutputError) as caught:
            export(checkpoint, out)
        assert str(caught.value) == f"--out {out}: {why}"
    assert sorted(os.listdir(tmp_path)) == ["arm.pt", "file", "folder"]


@pytest.mark.parametrize("name", ["robot.toml", "model.xml", "draws.toml", "limits.toml"])
def test_no_file_of_the_robot_is_written_over(tmp_path, name):
    robot, checkpoint = copy_of_arm(tmp_path), saved(tmp_path)
    out, before = robot / name, (robot / name).read_bytes()
    with pytest.raises(OutputError, match=f"--out {out}: found a file that is read, expected another place"):
        export(checkpoint, out, robot)
    assert out.read_bytes() == before


# ---- the command ----


def test_a_policy_is_a_path_or_a_shipped_name(tmp_path, monkeypatch):
    checkpoint = saved(tmp_path)
    assert find_checkpoint(str(checkpoint)) == checkpoint
    monkeypatch.setattr("policies.export.cli.POLICIES", tmp_path)
    assert find_checkpoint("arm.pt") == checkpoint
    for name in ("leg.pt", "x" * 300):
        with pytest.raises(ContractError, match=rf"--policy {name}: no such file, .* policies/: arm\.pt"):
            find_checkpoint(name)


def test_the_default_out_is_named_after_the_policy(tmp_path, monkeypatch, capsys):
    checkpoint = saved(tmp_path, name="reach7.pt")
    monkeypatch.chdir(tmp_path)
    assert policy_export(str(checkpoint)) == 0
    policy = Policy.load("out/reach7.onnx", SPEC)
    printed = capsys.readouterr().out
    assert printed.startswith(
        f"out/reach7.onnx: {Path('out/reach7.onnx').stat().st_size} bytes, sha256 {policy.digest}"
    )
    assert "on 1100 observations of real rollouts: largest deviation " in printed


def test_bad_input_exits_with_2_and_one_line(call, tmp_path):
    path = tmp_path / "evil.pt"
    path.write_bytes(b"nothing good")
    what = "found no archive that can be read: a BadZipFile, expected a checkpoint of policy-train"
    expected = f"error: {path}: {what}\n"
    assert call(cli, "--policy", path, "--out", tmp_path / "x.onnx") == (2, "", expected)
    assert os.listdir(tmp_path) == ["evil.pt"]
