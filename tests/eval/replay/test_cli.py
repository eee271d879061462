"""Command line of soak-replay: it does not write over what it reads."""

import pytest

from deploy.start import BAD_INPUT
from eval.replay.bundle import MCAP, ROBOT, STATE
from eval.replay.cli import cli


@pytest.mark.parametrize("option", ["--mcap", "--video"])
@pytest.mark.parametrize(
    "name", [STATE, MCAP, f"{ROBOT}/robot.toml", "../bundle/bundle.json", "../other.mcap"]
)
def test_no_file_of_the_bundle_is_written_over(call, tmp_path, option, name):
    """By its own name, by another path to it, or by a link."""
    folder = tmp_path / "bundle"
    (folder / ROBOT).mkdir(parents=True)
    (tmp_path / "other.mcap").symlink_to(folder / MCAP)
    (folder / MCAP).write_bytes(b"a recording")
    (folder / name).write_bytes(b"as it was")
    code, _, said = call(cli, folder, option, folder / name)
    assert code == BAD_INPUT
    assert said == f"error: {option} {folder / name}: found a place in the bundle, expected another one\n"
    assert (folder / name).read_bytes() == b"as it was"


def test_two_outputs_in_one_place_are_refused(call, tmp_path):
    code, _, said = call(
        cli, tmp_path / "bundle", "--mcap", tmp_path / "a.gif", "--video", tmp_path / "a.gif"
    )
    assert (code, said) == (BAD_INPUT, "error: --video and --mcap: found the same file, expected two\n")
