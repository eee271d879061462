"""Motor temperatures from one run to the next."""

import json

import numpy as np
import pytest

from deploy.estimation.winding_observer import WindingObserver
from deploy.operation.temperature_file import TemperatureFile
from robots.errors import ConfigError, OutputError
from support.arm6 import SPEC
from support.deploy.thermal import NOMINAL, live, sample

N, THEN = SPEC.n, 1_700_000_000.0
TAU = NOMINAL.to_housing * NOMINAL.capacity
GOOD = {
    "robot": "arm6",
    "joints": list(SPEC.joint_names),
    "unix_s": THEN,
    "rise_k": [10.0 * j for j in range(N)],
}


def opened(path, at=THEN, **how):
    """A file of an observer that has not ticked yet, and that observer."""
    heat = WindingObserver(SPEC, 1)
    return TemperatureFile(path, SPEC, heat, now=lambda: at, **how), heat


def test_file_of_another_robot_is_not_used(tmp_path):
    path = tmp_path / "heat.json"
    path.write_text(json.dumps(GOOD))
    assert (opened(path)[1].rise > 0).any()
    _, heat = opened(path, same_robot=False)
    np.testing.assert_array_equal(heat.rise, 0.0)
    assert not any(json.loads(path.read_text())["rise_k"])


def test_a_winding_stays_warm_through_a_restart_and_cools_while_it_is_off(tmp_path):
    path = tmp_path / "heat.json"
    file, heat = opened(path)
    live(heat, sample(0.0, 40.0))
    heat.winding[:] = 40.0 + np.array(GOOD["rise_k"])
    file.save()
    file.close()
    assert file.error is None
    assert json.loads(path.read_text()) == GOOD
    for off in (0.0, 30.0, 86_400.0):
        _, later = opened(path, THEN + off)
        path.write_text(json.dumps(GOOD))
        live(later, sample(0.0, 33.0))
        expected = 33.0 + np.array(GOOD["rise_k"]) * np.exp(-off / TAU)
        np.testing.assert_allclose(later.winding[0], expected, atol=0.01)


def test_implausible_temperatures_are_clipped(tmp_path):
    file, heat = opened(tmp_path / "heat.json")
    live(heat, sample(0.0, 40.0))
    heat.winding[:] = 1e6
    file.save()
    file.close()
    assert file.error is None
    assert json.loads((tmp_path / "heat.json").read_text())["rise_k"] == [500.0] * N


def test_clock_set_back_cools_nothing(tmp_path):
    path = tmp_path / "heat.json"
    path.write_text(json.dumps(GOOD))
    _, heat = opened(path, THEN - 3600.0)
    np.testing.assert_allclose(heat.rise[0], GOOD["rise_k"])


def test_a_first_run_begins_with_nothing_and_leaves_a_file(tmp_path):
    path = tmp_path / "heat.json"
    file, heat = opened(path)
    file.close()  # no sample ever came: nothing is known, and what stands there stays
    np.testing.assert_array_equal(heat.rise, 0.0)
    assert json.loads(path.read_text()) == {**GOOD, "rise_k": [0.0] * N}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"robot": "planar3"}, r"robot: found 'planar3', expected 'arm6'"),
        ({"joints": ["a"], "rise_k": [1.0]}, r"joints: found \('a',\), expected \('shoulder_pan'"),
        ({"rise_k": [1.0]}, r"rise_k holds 1 numbers for 6 joints"),
        ({"rise_k": [1e9] * N}, r"rise_k\.0: .*less than or equal to 500"),
        ({"rise_k": [-200.0] * N}, r"rise_k\.0: .*greater than or equal to -10"),
        ({"rise_k": ["hot"] * N}, r"rise_k\.0"),
        ({"unix_s": -5.0}, r"unix_s: .*greater than or equal to 0"),
        ({"more": 1}, r"more"),
    ],
)
def test_foreign_file_is_refused_and_kept(tmp_path, change, words):
    path = tmp_path / "heat.json"
    text = json.dumps({**GOOD, **change})
    path.write_text(text)
    with pytest.raises(ConfigError, match=rf"heat\.json: .*{words}"):
        opened(path)
    assert path.read_text() == text


@pytest.mark.parametrize(
    "content", [b"{", b"\xff\xfe", b'{"unix_s": NaN}', b"[]", b"[" * 50_000, b" " * 100_000]
)
def test_malformed_json_is_refused(tmp_path, content):
    path = tmp_path / "heat.json"
    path.write_bytes(content)
    with pytest.raises(ConfigError, match=r"heat\.json"):
        opened(path)


def test_unwritable_path_is_an_error_before_any_motion(tmp_path):
    (tmp_path / "full").write_text("")
    with pytest.raises((OutputError, ConfigError), match=r"full"):
        opened(tmp_path / "full" / "heat.json")


def test_later_disk_failure_is_reported_and_stops_nothing(tmp_path):
    folder = tmp_path / "disk"
    file, heat = opened(folder / "heat.json")
    live(heat, sample(0.0, 40.0))
    (folder / "heat.json").unlink()
    folder.rmdir()
    folder.write_text("")
    file.save()
    file.close()
    assert file.error.startswith(f"motor temperatures --out {folder / 'heat.json'}: cannot be written")


def test_a_failure_that_was_made_good_is_none(tmp_path):
    folder = tmp_path / "disk"
    file, heat = opened(folder / "heat.json")
    live(heat, sample(0.0, 40.0))
    folder.rename(tmp_path / "away")
    folder.write_text("")
    file.save()
    assert file._writing.exception()
    folder.unlink()
    file.close()
    assert file.error is None
    assert (folder / "heat.json").exists()
