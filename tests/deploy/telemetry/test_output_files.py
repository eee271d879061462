import os

import pytest

from deploy.telemetry.output_files import replacing
from robots.errors import OutputError


def test_a_file_is_replaced_when_the_block_ends_well(tmp_path):
    path = tmp_path / "new" / "folder" / "x.bin"
    for text in ("first", "second"):
        with replacing(path) as partial:
            partial.write_text(text)
        assert path.read_text() == text
    assert os.listdir(path.parent) == ["x.bin"]


def written_by_half(path, error):
    with replacing(path) as partial:
        partial.write_text("half")
        raise error


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_file_is_unchanged_when_the_block_raises(tmp_path, error):
    path = tmp_path / "x.bin"
    path.write_text("older")
    with pytest.raises(error):
        written_by_half(path, error)
    assert path.read_text() == "older"
    assert os.listdir(tmp_path) == ["x.bin"]


def test_a_full_disk_is_an_output_error(tmp_path):
    with pytest.raises(OutputError) as caught, replacing(tmp_path / "x.bin"):
        raise OSError(28, "No space left on device")
    assert str(caught.value) == f"--out {tmp_path / 'x.bin'}: cannot be written: No space left on device"
    assert os.listdir(tmp_path) == []


def test_write_protected_file_is_kept(tmp_path, monkeypatch):
    path = tmp_path / "x.bin"
    path.write_text("precious")
    monkeypatch.setattr("os.access", lambda *_: False)  # root may write anything
    with pytest.raises(OutputError, match="found a write-protected file"), replacing(path):
        pass
    assert path.read_text() == "precious"


def test_the_new_file_has_the_usual_permissions(tmp_path):
    (tmp_path / "plain").write_text("")
    with replacing(tmp_path / "x.bin"):
        pass
    assert (tmp_path / "x.bin").stat().st_mode == (tmp_path / "plain").stat().st_mode
