import os
import shutil
import subprocess
import sys

import numpy as np
import pytest

from robots.kernel import FLOAT, array, inlined, kernel
from support.paths import ROOT

SOURCE = """
import numpy as np

from robots.kernel import FLOAT, array, kernel


@kernel(array(FLOAT, 1), array(FLOAT, 1, written=True))
def double(x, y):
    for place in range(len(x)):
        y[place] = 2.0 * x[place]


y = np.zeros(3)
double(np.arange(3.0), y)
print(y.tolist())
"""


@inlined
def _third(x):
    return x / 3.0


@kernel(array(FLOAT, 2), FLOAT, array(FLOAT, 1, written=True))
def _mean_of_thirds(x, scale, out):
    for row in range(len(x)):
        out[row] = 0.0
        for column in range(x.shape[1]):
            out[row] += _third(x[row, column]) * scale
        out[row] /= x.shape[1]


def test_kernel_takes_arrays_of_any_strides_that_may_be_read_only():
    x, out = np.arange(12.0).reshape(3, 4), np.zeros((3, 2))
    x.setflags(write=False)
    for each in (x, x[:, ::2], x.T[:3], np.broadcast_to(1.0, (3, 2))):
        _mean_of_thirds(each, 3.0, out[:, 1])
        np.testing.assert_allclose(out[:, 1], each.mean(axis=1))


def test_a_division_by_zero_is_not_a_number():
    out = np.zeros(1)
    _mean_of_thirds(np.zeros((1, 0)), 1.0, out)
    assert np.isnan(out[0])


def test_nothing_is_compiled_after_the_import():
    with pytest.raises(TypeError, match="No matching definition"):
        _mean_of_thirds(np.zeros((3, 4), dtype=np.float32), 1.0, np.zeros(3))
    assert len(_mean_of_thirds.signatures) == 1


def test_what_a_kernel_does_not_write_it_may_not_write():
    with pytest.raises(Exception, match="Cannot modify readonly array"):

        @kernel(array(FLOAT, 1))
        def _clear(x):
            x[0] = 0.0


def run(folder, source=SOURCE, printed="[0.0, 2.0, 4.0]", home="/dev/null", **environment):
    """Run a module with one kernel in a process of its own, in its folder, with a copy of the package."""
    (folder / "module.py").write_text(source)
    if not (folder / "robots").exists():
        (folder / "robots").mkdir()
        (folder / "robots" / "__init__.py").touch()
        shutil.copy(ROOT / "robots" / "kernel.py", folder / "robots")
    variables = {**os.environ, "PYTHONPATH": str(folder), "HOME": str(home), **environment}
    command = [sys.executable, "-B", "module.py"]
    found = subprocess.run(command, cwd=folder, env=variables, capture_output=True, text=True, check=False)
    assert (found.returncode, found.stdout, found.stderr) == (0, f"{printed}\n", "")


def kept(folder):
    """Files of compiled code."""
    return [path for path in folder.rglob("*") if path.suffix in {".nbi", ".nbc"}]


def test_compiled_code_is_kept_beside_the_source_or_in_the_users_folder(tmp_path):
    home = tmp_path / "home"
    run(tmp_path, home=home)
    beside = tmp_path / "robots" / "__pycache__"
    assert len(kept(beside)) == 2
    assert not home.exists()
    shutil.rmtree(beside)
    beside.touch()  # no folder can be made there
    run(tmp_path, home=home)
    assert len(kept(home / ".cache" / "firstshift")) == 2


def test_without_any_folder_it_is_compiled_each_time(tmp_path):
    """The working directory is none: a relative home, or a cache there, is not used."""
    (tmp_path / "robots").mkdir()
    (tmp_path / "robots" / "__pycache__").touch()
    (tmp_path / "robots" / "__init__.py").touch()
    shutil.copy(ROOT / "robots" / "kernel.py", tmp_path / "robots")
    for home in ("/dev/null", ".", ""):
        run(tmp_path, home=home, XDG_CACHE_HOME="", NUMBA_CACHE_DIR=".")
    assert not kept(tmp_path)


def test_a_damaged_cache_costs_time_once(tmp_path):
    run(tmp_path)
    for path in kept(tmp_path):
        path.write_bytes(b"")
    run(tmp_path)
    assert not kept(tmp_path)
    run(tmp_path)
    assert len(kept(tmp_path)) == 2


def test_code_of_another_version_is_never_run(tmp_path):
    """Its data file may be older than its index: after a full disk, or a computer that lost power."""
    run(tmp_path)
    (old,) = (path for path in kept(tmp_path) if path.suffix == ".nbc")
    data = old.read_bytes()
    run(tmp_path, SOURCE.replace("2.0 *", "3.0 *"), "[0.0, 3.0, 6.0]")
    (new,) = (
        path for path in kept(tmp_path) if path.suffix == ".nbc" and path.parent.parent != old.parent.parent
    )
    assert new.read_bytes() != data
    run(tmp_path)
    kernels = tmp_path / "robots" / "kernel.py"
    kernels.write_text(kernels.read_text().replace('"boundscheck": True', '"boundscheck": False'))
    run(tmp_path)
    assert len({path.parent.parent for path in kept(tmp_path)}) == 3


def test_settings_in_the_working_directory_are_not_read(tmp_path):
    cache = tmp_path / "theirs"
    (tmp_path / ".numba_config.yaml").write_text(f"cache_dir: {cache}\nunknown: [")
    run(tmp_path)
    (tmp_path / ".numba_config.yaml").write_text(f"cache_dir: {cache}\ndisable_jit: 1")
    run(tmp_path)
    assert not cache.exists()


def test_an_index_outside_of_an_array_is_an_error():
    with pytest.raises(IndexError):
        _mean_of_thirds(np.zeros((3, 4)), 1.0, np.zeros(2))
