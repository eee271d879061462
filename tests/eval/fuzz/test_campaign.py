"""The fuzzer finds readers that fail, keeps their files, and goes on."""

import pytest

from eval.fuzz.__main__ import fuzz
from eval.fuzz.campaign import run_campaign
from eval.fuzz.target import find_targets
from support.paths import ROOT

TABLE = "support.eval.planted:TARGETS"
WORDS = {
    "traceback": "ZeroDivisionError: 'of ours' in planted.py",
    "crash": "exit code -6: a crash, or more than",
    "hang": "exit code -14: a crash, or more than",
    "memory": "MemoryError",
    "flood": "a message of 10000 characters: 'xxx",
}


@pytest.fixture(autouse=True)
def planted(monkeypatch):
    """Let workers import the readers that fail."""
    monkeypatch.setenv("PYTHONPATH", f"{ROOT}:{ROOT / 'tests'}")


@pytest.mark.parametrize(("name", "words"), WORDS.items(), ids=WORDS)
def test_a_reader_that_fails_is_found_and_its_file_kept(tmp_path, name, words):
    target = find_targets(TABLE)[name]
    found = run_campaign(TABLE, name, target, tmp_path, seed=7, seconds=1)
    assert found.failures
    assert all(failure.startswith(words) for failure in found.failures.values())
    for number in found.failures:
        assert (tmp_path / f"{name}-7-{number}" / "x.txt").exists()


def test_a_reader_that_refuses_passes(tmp_path, capsys, monkeypatch):
    assert fuzz(seconds=1, seed=7, only="refusal", out=tmp_path / "out", table=TABLE) == 0
    said = capsys.readouterr().out
    assert "refusal: " in said
    assert "0 failures" in said
    assert fuzz(seconds=1, seed=7, only="traceback", out=tmp_path / "out", table=TABLE) == 1
    assert "ZeroDivisionError" in capsys.readouterr().out


def test_a_worker_that_cannot_begin_is_no_success(tmp_path):
    with pytest.raises(RuntimeError, match="a worker ended with exit code 1 before its first case"):
        run_campaign("support.nothing:X", "crash", find_targets(TABLE)["crash"], tmp_path, seed=7, seconds=1)
