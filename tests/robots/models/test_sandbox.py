"""A model that somebody else wrote."""

import errno
import os
import signal
import subprocess
import sys

import pytest

from support.arm6 import SPEC
from support.processes import NO_THREADS
from support.robots.model_files import write_stl

pytest.importorskip("mujoco")

from robots.errors import RobotError
from robots.models import sandbox
from robots.models.files import referenced_files
from robots.models.mujoco_model import ITERATIONS, SIZE_MIB, USER_NUMBERS_MAX, open_model
from robots.models.sandbox import MEMORY_GIB, check_compiles
from robots.robot_file import BODIES_MAX

BODY = '<body name="a"><joint name="j"/><geom size="0.1"/>{}</body>'


def written(folder, inside="", body=""):
    path = folder / "model.xml"
    path.write_text(f"<mujoco>{inside}<worldbody>{BODY.format(body)}</worldbody></mujoco>")
    return path


def test_valid_model_passes(tmp_path):
    check_compiles(SPEC.model_path, SPEC.folder)
    check_compiles(written(tmp_path), tmp_path)


@pytest.mark.parametrize(
    ("inside", "body", "message"),
    [
        ('<option gravity="nan 0 0"/>', "<geom/>", r"model\.xml: MuJoCo cannot read it: .*size"),
        ("", "<geom/>", r"model\.xml: MuJoCo cannot read it: .*size"),
        ('<size nuserdata="2000000000"/>', "", r"model\.xml: MuJoCo cannot read it: .*[Cc]ould not allocate"),
    ],
)
def test_mujoco_error_is_reported(tmp_path, inside, body, message):
    path = written(tmp_path, inside, body)
    with pytest.raises(RobotError, match=message) as caught:
        check_compiles(path, tmp_path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("option", ITERATIONS)
def test_too_many_iterations_are_refused(tmp_path, option):
    path = written(tmp_path, f'<option {option}="1001"/>')
    with pytest.raises(RobotError) as caught:
        open_model(path, tmp_path)
    assert str(caught.value) == f"{path}: option {option}: found 1001, expected at most 1000"
    open_model(written(tmp_path, f'<option {option}="1000"/>'), tmp_path)


@pytest.mark.parametrize(
    ("inside", "mib"),
    [
        ('<asset><texture name="t" type="2d" builtin="flat" width="9500" height="9500"/></asset>', 271),
        ('<size memory="300M"/>', 300),
        ('<sensor><user dim="35000000"/></sensor>', 280),
        ('<size nuserdata="2200000"/>', 282),  # of 16 robots
    ],
)
def test_model_that_needs_too_much_memory_once_compiled_is_refused(tmp_path, inside, mib):
    path = written(tmp_path, inside)
    with pytest.raises(RobotError) as caught:
        check_compiles(path, tmp_path)
    assert (
        str(caught.value)
        == f"{path}: found {mib} MiB of memory once compiled, expected at most {SIZE_MIB} MiB"
    )


def test_model_of_the_largest_size_passes(tmp_path):
    check_compiles(written(tmp_path, '<size memory="255M"/>'), tmp_path)


@pytest.mark.parametrize("name", ["nuser_geom", "nuser_tendon"])
def test_too_many_numbers_of_the_user_are_refused(tmp_path, name):
    """Also of elements that the model has none of: a simulation adds some."""
    path = written(tmp_path, f'<size {name}="{USER_NUMBERS_MAX + 1}"/>')
    with pytest.raises(RobotError) as caught:
        check_compiles(path, tmp_path)
    assert str(caught.value) == f"{path}: size {name}: found 1001, expected at most 1000"


def test_a_child_whose_exit_code_is_lost_must_say_that_it_passed(tmp_path):
    before = signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    try:
        check_compiles(written(tmp_path), tmp_path)
        with pytest.raises(
            RobotError, match=r"model\.xml: MuJoCo cannot compile it within .*found 1001 bodies"
        ):
            check_compiles(written(tmp_path, f"<worldbody>{'<body/>' * BODIES_MAX}</worldbody>"), tmp_path)
    finally:
        signal.signal(signal.SIGCHLD, before)


def test_too_many_bodies_are_refused(tmp_path):
    path = written(tmp_path, f"<worldbody>{'<body/>' * BODIES_MAX}</worldbody>")
    with pytest.raises(RobotError, match=r"m.*xml: found 1001 bodies, expected at most 1000$"):
        check_compiles(path, tmp_path)


@pytest.mark.slow
def test_model_that_compiles_too_long_is_refused(tmp_path):
    texture = '<texture type="2d" name="{}" builtin="gradient" width="10000" height="10000"/>'
    path = written(tmp_path, f"<asset>{''.join(map(texture.format, range(20)))}</asset>")
    with pytest.raises(
        RobotError, match=rf"cannot compile it within 3 s of a core and {MEMORY_GIB} GiB: exit code -"
    ):
        check_compiles(path, tmp_path, cpu_s=3)


def start_with(monkeypatch, *lines):
    """Let a script of these lines start in place of the compilation."""
    run = subprocess.run
    monkeypatch.setattr(
        subprocess, "run", lambda child, **more: run([child[0], "-c", "\n".join(lines)], **more)
    )


def test_a_compilation_that_somebody_has_stopped_is_killed(monkeypatch, tmp_path):
    """SIGSTOP: no alarm reaches it."""
    start_with(monkeypatch, "import os, signal", "os.kill(os.getpid(), signal.SIGSTOP)")
    monkeypatch.setattr(sandbox, "GRACE_S", 1.0)
    with pytest.raises(RobotError, match=r"model\.xml: MuJoCo cannot .*: not finished after 1 s$"):
        check_compiles(written(tmp_path), tmp_path, cpu_s=0)


def test_a_compilation_without_a_thread_says_nothing_about_the_model(monkeypatch, tmp_path):
    start_with(monkeypatch, NO_THREADS, "from robots.child_process import end_with", "end_with(0)")
    with pytest.raises(BlockingIOError, match=os.strerror(errno.EAGAIN)):
        check_compiles(written(tmp_path), tmp_path)


def test_what_the_compilation_says_may_be_any_bytes(monkeypatch, tmp_path):
    """MuJoCo quotes names from the file."""
    start_with(monkeypatch, "import sys", "sys.stderr.buffer.write(b'br\\xc3\\xb6ken \\xff')", "sys.exit(2)")
    with pytest.raises(RobotError, match=r"^bröken \ufffd$"):
        check_compiles(written(tmp_path), tmp_path)


def test_no_code_of_the_current_folder_runs(tmp_path, monkeypatch):
    for name in ("mujoco.py", "resource.py"):
        (tmp_path / name).write_text("from pathlib import Path\nPath('ran').touch()\n")
    monkeypatch.chdir(tmp_path)
    check_compiles(written(tmp_path), tmp_path)
    assert not (tmp_path / "ran").exists()


@pytest.mark.slow
def test_lower_system_limits_are_no_obstacle(tmp_path):
    """A process whose own hard limits are below those of the sandbox cannot raise them, and need not."""
    path = written(tmp_path)
    code = (
        "import resource, sys; from pathlib import Path; from robots.models.sandbox import check_compiles\n"
        "resource.setrlimit(resource.RLIMIT_CPU, (20, 20))\n"
        "resource.setrlimit(resource.RLIMIT_DATA, (2 << 30, 2 << 30))\n"
        "check_compiles(Path(sys.argv[1]), Path(sys.argv[1]).parent)\n"
    )
    subprocess.run([sys.executable, "-c", code, str(path)], check=True)


@pytest.mark.parametrize("decoy", [False, True])
@pytest.mark.parametrize(
    ("compiler", "file"),
    [
        ("", "../secret/a.stl"),
        ("", "{}/secret/a.stl"),
        ('<compiler meshdir="../secret"/>', "a.stl"),
        ('<compiler assetdir="{}/secret"/>', "a.stl"),
        ('<compiler strippath="true"/><compiler strippath="false"/>', "{}/secret/a.stl"),
    ],
)
def test_file_outside_the_folder_is_not_opened(tmp_path, compiler, file, decoy):
    """Not even where one of the same name lies inside, for MuJoCo would take the other."""
    write_stl(tmp_path / "secret" / "a.stl")
    (tmp_path / "robot").mkdir()
    if decoy:
        write_stl(tmp_path / "robot" / "a.stl")
    mesh = f'{compiler}<asset><mesh name="m" file="{file}"/></asset>'.replace("{}", str(tmp_path))
    with pytest.raises(RobotError, match="expected a file inside"):
        check_compiles(written(tmp_path / "robot", mesh), tmp_path / "robot")


@pytest.mark.parametrize(
    ("compiler", "file", "found"),
    [
        ("", "a.stl", ["a.stl"]),
        ('<compiler meshdir="m"/>', "a.stl", ["m/a.stl"]),
        ('<compiler meshdir="m"/>', "../a.stl", ["a.stl"]),
        ('<compiler texturedir="../t"/>', "a.stl", ["a.stl"]),  # no texture is named
        ('<compiler assetdir="m"/>', "a.stl", ["m/a.stl"]),
        ('<compiler assetdir="m" meshdir="n"/>', "a.stl", ["m/a.stl", "n/a.stl"]),  # one of them
        ('<compiler meshdir="m" strippath="true"/>', "/home/vendor/a.stl", ["m/a.stl"]),
    ],
)
def test_every_path_that_mujoco_may_open_is_a_file_of_the_model(tmp_path, compiler, file, found):
    for name in ("a.stl", "m/a.stl", "n/a.stl"):
        write_stl(tmp_path / name)
    path = written(tmp_path, f'{compiler}<asset><mesh name="m" file="{file}"/></asset>')
    assert [str(each.relative_to(tmp_path)) for each in referenced_files(path, tmp_path)] == found
    check_compiles(path, tmp_path)
