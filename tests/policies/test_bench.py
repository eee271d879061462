import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("onnxscript")
pytest.importorskip("rsl_rl.models")

from policies import bench as command
from policies.importers.contract_draft import read_draft
from policies.importers.readers import read_policy
from support.arm6 import SPEC

pytestmark = pytest.mark.slow

KINDS = {
    "ONNX": "ONNX",
    "rsl_rl, MLP": "rsl_rl MLP with a normalizer",
    "rsl_rl, LSTM": "rsl_rl LSTM with a normalizer",
    "TorchScript, LSTM": "TorchScript",
    "torch.export": "torch.export program",
    "state_dict": "state_dict of an MLP",
}


def test_each_file_kind_is_recognized_and_fits_its_contract(tmp_path):
    files = command.write_files(tmp_path, SPEC, layers=(16, 8))
    found = {}
    for kind, (path, network) in files.items():
        draft = tmp_path / "x.toml"
        draft.write_text(command.contract(SPEC, network))
        facts = read_policy(path, read_draft(draft).network).facts
        assert (facts.observations, facts.actions) == (21, 6)
        found[kind] = facts.kind
    assert found == KINDS


def test_loading_time_is_printed(arm_policy, capsys):
    command.loads(SPEC, arm_policy)
    assert ": loaded and verified in 0." in capsys.readouterr().out


def test_an_unknown_bench_is_refused(call):
    code, _, said = call(lambda: command.main(command.bench), "nothing")
    assert code == 2
    assert "found 'nothing', expected one of import, load, episodes or all" in said
