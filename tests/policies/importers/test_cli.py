"""policy-import, from files that rsl_rl itself exported to a policy that the arm loads."""

import os
import re
import shutil
import sys
from pathlib import Path

import numpy as np
import onnx
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("onnxscript")
tensordict = pytest.importorskip("tensordict")
models = pytest.importorskip("rsl_rl.models")

from deploy.policy.policy import Policy
from policies.importers.cli import cli, import_policy, policy_import
from policies.importers.contract_draft import read_draft
from robots.errors import ContractError, OutputError
from support.arm6 import SPEC, copy_of_arm
from support.contracts import NAMES
from support.importers.imports import CONTRACT, THEIRS, A, N, exported

pytestmark = pytest.mark.slow
linux_only = pytest.mark.skipif(sys.platform != "linux", reason="needs names that are not UTF-8")


@pytest.fixture(scope="module", params=["mlp", "lstm"])
def done(request, tmp_path_factory):
    """A foreign file, the module behind it, and what was imported."""
    folder = tmp_path_factory.mktemp(request.param)
    path, view = exported(folder, request.param)
    (folder / "contract.toml").write_text(CONTRACT)
    imported = import_policy(path, folder / "contract.toml", folder / "policy.onnx")
    return path, view, imported


def test_imported_policy_loads_and_equals_torch(done):
    path, view, imported = done
    assert 0 <= imported.deviation <= 1e-5
    policy = Policy.load(path.parent / "policy.onnx", SPEC)
    assert policy.digest == imported.digest
    assert policy.contract.joint_names == SPEC.joint_names
    rng, robots = np.random.default_rng(0), 5
    theirs = rng.normal(size=(20, robots, N)).astype(np.float32)
    order = [NAMES.index(name) for name in THEIRS]
    columns = np.concatenate([order, np.array(order) + 6, [12, 13, 14], np.array(order) + 15])
    ours = np.empty_like(theirs)
    ours[..., columns] = theirs
    policy.resize(robots)
    found = np.stack([policy.step(row).copy() for row in ours])
    for robot in range(robots):
        known = [torch.zeros_like(piece) for piece in view.get_dummy_inputs()[1:]]
        for step in range(len(theirs)):
            said = view(torch.from_numpy(theirs[step, robot][None]), *known)
            action, *known = said if isinstance(said, tuple) else (said,)
            np.testing.assert_allclose(
                found[step, robot, order], action[0].detach().numpy(), rtol=0, atol=2e-5
            )


def test_the_same_file_gives_the_same_bytes(done, tmp_path):
    path, _, imported = done
    again = import_policy(path, path.parent / "contract.toml", tmp_path / "again.onnx")
    assert again == imported
    assert (tmp_path / "again.onnx").read_bytes() == (path.parent / "policy.onnx").read_bytes()


def test_template_is_the_start_of_the_contract(done, tmp_path, capsys):
    path, *_ = done
    draft = tmp_path / "a\nnew.toml"
    assert policy_import(path, contract=draft, template=True) == 0
    assert re.search(
        rf"a\?new\.toml: ONNX.*, {N} observations, {A} actions; fill in \d+ values marked \?",
        capsys.readouterr().out,
    )
    with pytest.raises(ContractError, match=r"new\.toml: policy_hz: still '\?', to be filled in"):
        read_draft(draft)
    with pytest.raises(ContractError, match="exists already"):
        policy_import(path, contract=draft, template=True)


@pytest.mark.parametrize(
    "letter", [pytest.param("\x1b", id="escape"), pytest.param("\udcff", id="byte", marks=linux_only)]
)
def test_template_names_the_file_with_letters_that_can_be_printed(done, tmp_path, letter):
    path = shutil.copytree(done[0].parent, tmp_path / "export") / f"a{letter}.onnx"
    path.with_name(done[0].name).rename(path)
    assert policy_import(path, contract=tmp_path / "a.toml", template=True) == 0
    assert (tmp_path / "a.toml").read_text().startswith("# Contract of a?.onnx: ONNX")


def test_a_place_that_cannot_be_written_is_refused_before_the_work(done, tmp_path, monkeypatch):
    path, *_ = done
    monkeypatch.setattr("policies.importers.cli.record_reference", None)
    with pytest.raises(OutputError, match="cannot be written: File name too long"):
        import_policy(path, path.parent / "contract.toml", tmp_path / ("x" * 255))


def test_weights_outside_its_folder_are_refused(done, tmp_path):
    path, *_ = done
    model = onnx.load(path, load_external_data=False)
    held = [tensor for tensor in model.graph.initializer if tensor.external_data]
    if not held:
        held = list(model.graph.initializer)[:1]
        onnx.external_data_helper.set_external_data(held[0], "x")
        held[0].data_location = onnx.TensorProto.EXTERNAL
    for where in ("../secret", "/etc/passwd", "nowhere", "", "x" * 5000):
        for entry in held[0].external_data:
            entry.value = where if entry.key == "location" else entry.value
        (tmp_path / "bad.onnx").write_bytes(model.SerializeToString())
        (tmp_path / "contract.toml").write_text(CONTRACT)
        with pytest.raises(
            ContractError, match=re.escape(f"found its weights in {where!r:.100}, expected a file beside")
        ):
            import_policy(tmp_path / "bad.onnx", tmp_path / "contract.toml", tmp_path / "out.onnx")
    assert not (tmp_path / "out.onnx").exists()


def test_refused_import_keeps_the_old_file(done, tmp_path):
    path, *_ = done
    out, draft = tmp_path / "policy.onnx", tmp_path / "contract.toml"
    out.write_bytes(b"before")
    draft.write_text(
        CONTRACT.replace("[0.1, 0.2, 0.3, 0.4, 0.5, 0.6]\nmultiply = 0.5", "[0.1, 0.2]\nmultiply = 0.5")
    )
    with pytest.raises(ContractError, match="action: offset: found 2 numbers, expected 1 or 6"):
        import_policy(path, draft, out)
    draft.write_text(CONTRACT)
    with pytest.raises(ContractError, match=r"nothing\.onnx: cannot be read: No such file"):
        import_policy(Path("nothing.onnx"), draft, out)
    with pytest.raises(OutputError):
        import_policy(path, draft, out / "inside.onnx")
    assert out.read_bytes() == b"before"


def test_no_file_that_is_read_is_written_over(done, tmp_path):
    path, *_ = done
    robot, draft = copy_of_arm(tmp_path), path.parent / "contract.toml"
    for out in (path, draft, robot / "robot.toml", robot / "model.xml", robot / "draws.toml"):
        before = out.read_bytes()
        with pytest.raises(OutputError, match=f"--out {out}: found a file that is read"):
            import_policy(path, draft, out, robot)
        assert out.read_bytes() == before


@pytest.mark.parametrize("name", ["weights.data", "hard_link"])
def test_external_weights_are_not_written_over(done, tmp_path, name):
    model = onnx.load(done[0])
    onnx.save(
        model, tmp_path / "ext.onnx", save_as_external_data=True, location="weights.data", size_threshold=0
    )
    weights, out, draft = tmp_path / "weights.data", tmp_path / name, done[0].parent / "contract.toml"
    if name == "hard_link":
        os.link(weights, out)
    before = weights.read_bytes()
    with pytest.raises(OutputError, match=f"--out {out}: found a file that is read, expected another place"):
        import_policy(tmp_path / "ext.onnx", draft, out)
    assert weights.read_bytes() == before
    assert import_policy(tmp_path / "ext.onnx", draft, tmp_path / "out.onnx").deviation <= 1e-5


def test_too_long_a_name_of_the_contract_is_one_line(call, done, tmp_path):
    contract = tmp_path / f"{'x' * 300}.toml"
    code, _, said = call(cli, done[0], "--template", "--contract", contract)
    assert (code, said) == (2, f"error: --contract {contract}: cannot be written: File name too long\n")


@pytest.mark.parametrize("name", ["", ".", "/"])
@pytest.mark.parametrize("more", [[], ["--template"]])
def test_a_folder_is_no_policy_file(call, name, more):
    code, _, said = call(cli, name, *more)
    expected = "found the name of a folder, expected that of a policy file"
    assert (code, said) == (2, f"error: {name or '.'}: {expected}\n")


def test_a_policy_that_is_missing_is_named_before_its_contract(call, tmp_path):
    path = tmp_path / "missing.pt"
    assert call(cli, path)[::2] == (2, f"error: {path}: cannot be read: no such file\n")
