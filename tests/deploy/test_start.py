"""Starts of command lines: every script of pyproject.toml has one, which no failing output ends, nor Ctrl-C loudly."""

import ast
import contextlib
import errno
import os
import resource
import signal
import subprocess
import sys
import tomllib
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import pytest

from deploy.operation.interrupts import REQUESTS
from deploy.start import ADDRESSES_MIN, BAD_INPUT, BROKEN, ENVIRONMENT, INTERRUPTED, LACKING, STACK_MIN, start
from support.paths import ROOT

SCRIPTS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]


@pytest.mark.parametrize("script", SCRIPTS)
def test_script_starts_a_command_line(script):
    module, name = SCRIPTS[script].split(":")
    (command,) = getattr(import_module(module), name).args
    tree = ast.parse(Path(find_spec(command).origin).read_text())
    assert "cli" in {each.name for each in tree.body if isinstance(each, ast.FunctionDef)}


@pytest.fixture
def written(tmp_path, monkeypatch):
    """Writer of a module that can be imported."""
    monkeypatch.syspath_prepend(tmp_path)
    return lambda name, text: (tmp_path / f"{name}.py").write_text(text)


@pytest.fixture
def begun():
    """`start` in this process, whose signals are as before at the end."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, *REQUESTS)}
    yield start
    for number, handler in before.items():
        signal.signal(number, handler)


def run(module, folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, pass_fds=(), cwd=None, **environment):
    """Start a module of a folder in a process of its own."""
    code = (
        "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler);"  # a shell may ignore it,
        "signal.signal(signal.SIGQUIT, signal.SIG_DFL); signal.signal(signal.SIGHUP, signal.SIG_DFL);"  # or these
        f"sys.path.insert(0, {str(folder)!r}); from deploy.start import start; start({module!r})"
    )
    environment = os.environ | {"PYTHONPATH": str(ROOT)} | environment
    command, streams = [sys.executable, "-c", code], {"stdout": stdout, "stderr": stderr}
    return subprocess.run(
        command, env=environment, **streams, pass_fds=pass_fds, cwd=cwd, timeout=60, check=False
    )


def test_ctrl_c_during_imports_is_quiet(written, tmp_path):
    """Be it in a module that makes another exception of it, as C extensions do."""
    written(
        "interrupted_command",
        "import os, signal\ntry:\n    os.kill(os.getpid(), signal.SIGINT)\n"
        "except BaseException:\n    raise ImportError\n",
    )
    ended = run("interrupted_command", tmp_path)
    assert (ended.returncode, ended.stdout, ended.stderr) == (INTERRUPTED, b"", b"")


INTERRUPTED_IMPORT = """
import os, signal, sys
from importlib import import_module
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell may ignore it
command = getattr(import_module(sys.argv[1]), sys.argv[2])
class Interrupting:
    def find_spec(self, *_):
        os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Interrupting())
command()
"""


@pytest.mark.parametrize("script", SCRIPTS)
def test_ctrl_c_at_the_first_import_of_a_script_is_quiet(script):
    """Only the start itself is imported earlier."""
    ended = subprocess.run(
        [sys.executable, "-c", INTERRUPTED_IMPORT, *SCRIPTS[script].split(":")],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        timeout=60,
        check=False,
    )
    assert (ended.returncode, ended.stdout, ended.stderr) == (INTERRUPTED, b"", b"")


def test_ctrl_c_is_an_exception_again_when_the_command_runs(written, tmp_path):
    written(
        "patient_command",
        "import os, signal\ndef cli():\n    try:\n        os.kill(os.getpid(), signal.SIGINT)\n"
        "    except KeyboardInterrupt:\n        print('stopped')\n",
    )
    assert run("patient_command", tmp_path).stdout == b"stopped\n"


def test_ctrl_c_before_the_command_has_begun_is_quiet(written, tmp_path):
    written("slow_command", "import os, signal\ndef cli():\n    os.kill(os.getpid(), signal.SIGINT)\n")
    ended = run("slow_command", tmp_path)
    assert (ended.returncode, ended.stdout, ended.stderr) == (INTERRUPTED, b"", b"")


WRITER = """
import os, signal
from pathlib import Path

from deploy.command_line import main
from deploy.telemetry.output_files import replacing

def write() -> int:
    with replacing(Path(os.environ["PLACE"])) as partial:
        partial.write_text("a part")
        signal.raise_signal(int(os.environ["SIGNAL"]))
    return 0

def cli():
    main(write)
"""


@pytest.mark.parametrize("number", REQUESTS)
def test_a_request_to_end_leaves_no_part_of_a_file(written, tmp_path, number):
    written("writing_command", WRITER)
    place = tmp_path / "out" / "file"
    ended = run("writing_command", tmp_path, PLACE=str(place), SIGNAL=str(int(number)))
    assert (ended.returncode, ended.stdout, ended.stderr) == (INTERRUPTED, b"", b"")
    assert os.listdir(place.parent) == []


DROPPED = """
import signal, sys, time

from deploy.command_line import main

class Interrupted:
    def __del__(self):
        signal.raise_signal(signal.SIGTERM)

def wait() -> int:
    Interrupted()
    time.sleep(30)
    return 0

def cli():
    main(wait)
"""


def test_a_request_to_end_that_arrives_in_a_destructor_ends_the_command(written, tmp_path):
    written("destroying_command", DROPPED)
    ended = run("destroying_command", tmp_path)
    assert (ended.returncode, ended.stdout, ended.stderr) == (INTERRUPTED, b"", b"")


ENDING = """
import atexit, os, signal, sys

from deploy.command_line import main

def end() -> int:
    atexit.register(os.kill, os.getpid(), int(os.environ["SIGNAL"]))
    print("a result")
    return 1

def cli():
    main(end)
"""


@pytest.mark.parametrize("number", [signal.SIGINT, *REQUESTS])
def test_a_signal_after_the_command_changes_nothing(written, tmp_path, number):
    """When its results are written, and Python ends."""
    written("ending_command", ENDING)
    ended = run("ending_command", tmp_path, SIGNAL=str(int(number)))
    assert (ended.returncode, ended.stdout, ended.stderr) == (1, b"a result\n", b"")


WAITING = """
import os
from threading import Event, Thread, main_thread

from deploy.command_line import main

def hang():
    main_thread().join()
    while True:  # Python misses one that comes as it begins to wait
        os.kill(os.getpid(), int(os.environ["SIGNAL"]))
        Event().wait(0.05)

def begin() -> int:
    Thread(target=hang).start()
    return 0

def cli():
    main(begin)
"""


@pytest.mark.parametrize("number", [signal.SIGINT, *REQUESTS])
def test_a_command_that_waits_for_a_thread_at_its_end_is_ended(written, tmp_path, number):
    written("waiting_command", WAITING)
    ended = run("waiting_command", tmp_path, SIGNAL=str(int(number)))
    assert (ended.returncode, ended.stdout, ended.stderr) == (INTERRUPTED, b"", b"")


WITH_HANDLERS = WRITER.replace("main(write)", "with handled(interrupt): main(write)")
WITH_HANDLERS = f"{WITH_HANDLERS}\nfrom deploy.operation.interrupts import handled, interrupt\n"


@pytest.mark.parametrize("command", [WRITER, WITH_HANDLERS])
def test_a_request_that_is_ignored_stays_ignored(written, tmp_path, command):
    """As nohup does with that of a terminal that closes, in commands with handlers of their own as well."""
    written("writing_command", f"import signal\nsignal.signal(signal.SIGHUP, signal.SIG_IGN)\n{command}")
    place = tmp_path / "out" / "file"
    ended = run("writing_command", tmp_path, PLACE=str(place), SIGNAL=str(int(signal.SIGHUP)))
    assert (ended.returncode, ended.stderr, place.read_text()) == (0, b"", "a part")


BLOCKED = "signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM, signal.SIGINT})"
IGNORED = "signal.signal(signal.SIGCHLD, signal.SIG_IGN)"


@pytest.mark.parametrize(
    ("left", "asked", "answer"),
    [
        (BLOCKED, "signal.pthread_sigmask(signal.SIG_BLOCK, ())", b"set()\n"),
        (IGNORED, "subprocess.run(['false']).returncode", b"1\n"),
    ],
    ids=["blocked signals", "ignored children"],
)
def test_what_a_parent_did_to_signals_is_undone(written, tmp_path, left, asked, answer):
    """Else nothing would stop a command, and the system would keep no exit code of its children."""
    written("heir_command", f"import signal, subprocess\ndef cli():\n    print({asked})")
    written("parent", f"import signal\n{left}\n")
    path = f"import sys; sys.path.insert(0, {str(tmp_path)!r})"
    ended = subprocess.run(
        [
            sys.executable,
            "-c",
            f"{path}; import parent; from deploy.start import start; start('heir_command')",
        ],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        timeout=60,
        check=True,
    )
    assert ended.stdout == answer


@pytest.mark.parametrize(
    "environment",
    [
        {"PYTHONIOENCODING": "ascii"},
        {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
    ],
    ids=["encoding", "locale"],
)
def test_letters_that_a_terminal_lacks_are_escaped(written, tmp_path, environment):
    written("greek_command", "def cli():\n    print('5 \u00b5s \u2264 6')\n")
    ended = run("greek_command", tmp_path, **environment)
    assert (ended.returncode, ended.stdout) == (0, b"5 \\xb5s \\u2264 6\n")


def test_command_line_runs_once(written, capsys, begun):
    written("other_command", "def cli():\n    print('ran')\n")
    begun("other_command")
    assert capsys.readouterr().out == "ran\n"


LONG = """
import os, sys
def cli():
    for line in range(20_000):
        print("line", line)
    os.write({}, b"done")
    print("the last error", file=sys.stderr)
    raise SystemExit(3)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="needs /dev/full")
@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_a_full_disk_under_standard_output_ends_no_command(written, tmp_path, unbuffered):
    with (tmp_path / "done").open("wb") as done, open("/dev/full", "wb") as full:
        written("long_command", LONG.format(done.fileno()))
        ended = run(
            "long_command", tmp_path, PYTHONUNBUFFERED=unbuffered, stdout=full, pass_fds=[done.fileno()]
        )
    assert (ended.returncode, (tmp_path / "done").read_bytes()) == (3, b"done")
    warning = b"warning: standard output cannot be written: No space left on device\n"
    assert ended.stderr == warning + b"the last error\n"


def test_a_reader_that_is_gone_ends_no_command(written, tmp_path):
    reader, writer = os.pipe()
    os.close(reader)
    with (tmp_path / "done").open("wb") as done, open(writer, "wb") as pipe:
        written("long_command", LONG.format(done.fileno()))
        ended = run("long_command", tmp_path, stdout=pipe, stderr=pipe, pass_fds=[done.fileno()])
    assert (ended.returncode, (tmp_path / "done").read_bytes()) == (3, b"done")


SCRIPT = """
import os
from multiprocessing import get_context

from deploy.start import start

def cli():
    child = get_context("spawn").Process(target=os.getpid)
    child.start()
    child.join()
    raise SystemExit(child.exitcode)

if __name__ == "__main__":
    start("__main__")
"""


def test_no_child_imports_modules_of_the_working_directory(tmp_path):
    """It may be the folder of somebody else's robot."""
    folder, script = tmp_path / "robot", tmp_path / "bin" / "command"
    for path, text in ((folder / "signal.py", "open('ran', 'w')"), (script, SCRIPT)):
        path.parent.mkdir()
        path.write_text(text)
    ended = subprocess.run(
        [sys.executable, script],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        timeout=60,
        check=False,
    )
    assert (ended.returncode, ended.stderr) == (0, b"")
    assert not (folder / "ran").exists()


PLOTTING = """
import matplotlib, os
def cli():
    print(matplotlib.rcParams["text.usetex"], os.path.lexists("matplotlibrc"))
"""


@pytest.mark.parametrize("kind", ["pipe", "settings", "bytes"])
def test_no_settings_of_plots_are_read_in_the_working_directory(written, tmp_path, kind):
    path = tmp_path / "robot" / "matplotlibrc"
    path.parent.mkdir()
    if kind == "pipe":
        os.mkfifo(path)
    else:
        path.write_bytes(b"text.usetex: True" if kind == "settings" else b"\xff")
    written("plotting_command", PLOTTING)
    ended = run("plotting_command", tmp_path, cwd=path.parent)
    assert (ended.stdout, ended.stderr) == (b"False True\n", b"")


@pytest.mark.parametrize("name", ["MPLCONFIGDIR", "MATPLOTLIBRC"])
def test_no_settings_of_plots_are_read_elsewhere(written, tmp_path, name):
    (tmp_path / "matplotlibrc").write_text("text.usetex: True")
    written("plotting_command", PLOTTING)
    assert run("plotting_command", tmp_path, **{name: str(tmp_path)}).stdout.startswith(b"False")


@pytest.mark.parametrize(
    ("name", "value", "kept"),
    [
        ("COLUMNS", "80", True),
        ("LINES", "9999", True),
        ("COLUMNS", "0", False),
        ("COLUMNS", "\u00b2", False),
        ("LINES", "\u00b2", False),
        ("LINES", "10000", False),
        ("COLUMNS", "80\n", False),
        ("TORCH_LOGS", "zzz", False),
        ("TORCH_LOGS_FORMAT", "%z", False),
        ("TORCH_DISTRIBUTED_DEBUG", "zzz", False),
        ("TORCHINDUCTOR_CACHE_DIR", "/proc/x", False),
        ("PYTORCH_JIT_LOG_LEVEL", "zzz", False),
        ("PYTORCH_CUDA_ALLOC_CONF", "expandable_segments:True", True),
        ("CUDA_VISIBLE_DEVICES", "1", True),
        ("PROTOCOL_BUFFERS_PYTHON_IMPLEMENTATION", "zzz", False),
        ("SOURCE_DATE_EPOCH", "zzz", False),
        ("NUMPY_MADVISE_HUGEPAGE", "zzz", False),
        ("NUMBA_DISABLE_JIT", "1", False),
        ("NUMBA_CPU_NAME", "generic", False),
        ("NUMBA_CACHE_DIR", ".", False),
        ("MUJOCO_EGL_DEVICE_ID", "1", True),
        ("WORLD_SIZE", "2", False),
        ("TD_LOGGING_LEVEL", "zzz", False),
        ("PYTORCH_TENSORDICT_IMPORT_VMAP", "zzz", False),
        ("EXCLUDE_TD_FROM_PYTREE", "zzz", False),
        ("DISPATCH_TDNN_MODULES", "zzz", False),
        ("COMPOSITE_LP_AGGREGATE", "zzz", False),
        ("PYTHONINSPECT", "1", False),
        ("PYTHONWARNINGS", "ignore", False),
        ("GIT_PYTHON_GIT_EXECUTABLE", "/bin/false", False),
        ("_SOAK_TEST_COMPLETE", "zzz", False),
        ("_COMPLETE", "zzz", True),
    ],
)
def test_variables_that_end_libraries_are_removed(written, monkeypatch, name, value, kept, begun):
    for each in ENVIRONMENT:  # set by the start
        monkeypatch.setenv(each, "")
    monkeypatch.setenv(name, value)
    written("variable_command", "def cli():\n    pass\n")
    begun("variable_command")
    assert os.environ.get(name) == (value if kept else None)


def test_the_simulator_imports_no_renderer(written, tmp_path):
    """It would start a process of its own, and Ctrl-C would end that with a traceback."""
    written("simulating_command", "import sys, mujoco\ndef cli():\n    print('glfw' in sys.modules)\n")
    ended = run("simulating_command", tmp_path, MUJOCO_GL="glfw")
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, b"False\n", b"")


@pytest.mark.parametrize("date", ["", "zzz"])
def test_a_date_of_builds_is_not_read(written, tmp_path, date):
    """By numpy."""
    written("build_command", "import numpy.f2py\ndef cli():\n    print('ran')\n")
    ended = run("build_command", tmp_path, SOURCE_DATE_EPOCH=date)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, b"ran\n", b"")


WARNING = """
import subprocess, sys, warnings
from multiprocessing import get_context

def warn():
    warnings.warn("for developers", DeprecationWarning)
    warnings.warn("a number", RuntimeWarning)

def cli():
    warn()
    child = get_context("spawn").Process(target=warn)
    child.start()
    child.join()
    print(child.exitcode)
"""


@pytest.mark.parametrize("action", ["error", "always", "ignore"])
def test_warnings_are_no_errors(written, tmp_path, action):
    """Nor in a child; whoever uses a command sees those that Python shows to users."""
    written("warning_command", WARNING)
    ended = run("warning_command", tmp_path, PYTHONWARNINGS=action, PYTHONPATH=f"{ROOT}:{tmp_path}")
    assert (ended.returncode, ended.stdout) == (0, b"0\n")
    assert (ended.stderr.count(b"for developers"), ended.stderr.count(b"RuntimeWarning: a number")) == (0, 2)


def test_development_mode_changes_no_result(written, tmp_path):
    """Python's, in which a process starts children with warnings of its own."""
    written("warning_command", WARNING)
    ended = run("warning_command", tmp_path, PYTHONDEVMODE="1", PYTHONPATH=f"{ROOT}:{tmp_path}")
    assert (ended.returncode, ended.stdout) == (0, b"0\n")


@pytest.mark.parametrize("refresh", ["", "raise"])
def test_git_is_not_needed(written, tmp_path, refresh):
    """By GitPython, which rsl_rl imports."""
    pytest.importorskip("git")
    written("git_command", "import git\ndef cli():\n    print('ran')\n")
    ended = run("git_command", tmp_path, PATH=str(tmp_path), GIT_PYTHON_REFRESH=refresh)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, b"ran\n", b"")


OPENING = """
import os, subprocess, sys
from pathlib import Path

CHILD = "import os, sys; sys.exit(sum(os.readlink(f'/proc/self/fd/{n}') == os.devnull for n in range(3)))"

def cli():
    reading, _ = os.pipe()
    found = [name for name in ("stdin", "stdout", "stderr") if getattr(sys, name) is None]
    child = subprocess.run([sys.executable, "-c", CHILD], input=b"" if "stdin" in found else None)
    Path("found").write_text(f"{reading > 2} {found} {child.returncode}")
"""


@pytest.mark.skipif(sys.platform != "linux", reason="needs /proc")
@pytest.mark.parametrize(
    ("closed", "streams", "empty"),
    [
        ("<&-", ["stdin"], 0),
        (">&- 2>&-", ["stdout", "stderr"], 2),
        ("<&- >&- 2>&-", ["stdin", "stdout", "stderr"], 2),
    ],
)
def test_no_file_gets_the_number_of_a_standard_stream_that_is_closed(
    written, tmp_path, closed, streams, empty
):
    """Nor in a child, which has its own input where the command gives it one."""
    written("opening_command", OPENING)
    code = "from deploy.start import start; start('opening_command')"
    ended = subprocess.run(
        ["/bin/sh", "-c", f'exec "$0" -c "$1" {closed}', sys.executable, code],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": f"{ROOT}:{tmp_path}"},
        stdin=subprocess.PIPE,
        capture_output=True,
        timeout=60,
        check=False,
    )
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, b"", b"")
    assert (tmp_path / "found").read_text() == f"True {streams} {empty}"


LEFT_BEHIND = """
import os
from deploy.start import start
os.mkdir("gone")
os.chdir("gone")
os.rmdir("../gone")
start("no_such_command")
"""


def test_a_working_directory_that_was_deleted_is_bad_input(tmp_path):
    ended = subprocess.run(
        [sys.executable, "-c", LEFT_BEHIND],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        timeout=60,
        check=False,
    )
    said = f"error: working directory: {os.strerror(errno.ENOENT)}, expected one that exists\n"
    assert (ended.returncode, ended.stdout, ended.stderr.decode()) == (BAD_INPUT, b"", said)


def test_a_working_directory_that_is_deleted_in_between_is_bad_input(written, tmp_path):
    (tmp_path / "robot").mkdir()
    written("deserted_command", "import os\nos.rmdir('../robot')\nos.path.abspath('arm.onnx')")
    ended = run("deserted_command", tmp_path, cwd=tmp_path / "robot")
    said = f"error: working directory: {os.strerror(errno.ENOENT)}, expected one that exists\n"
    assert (ended.returncode, ended.stdout, ended.stderr.decode()) == (BAD_INPUT, b"", said)


def test_a_library_that_cannot_be_imported_is_no_verdict(written, tmp_path):
    written("broken_command", "raise ValueError('no such backend')")
    ended = run("broken_command", tmp_path)
    assert ended.returncode == BROKEN
    assert ended.stderr.endswith(b"ValueError: no such backend\n")


def test_too_few_open_files_for_imports_are_one_line(written, tmp_path):
    written(
        "greedy_command",
        "import os, resource\nresource.setrlimit(resource.RLIMIT_NOFILE, (8, 8))\nfor _ in range(9):\n    os.pipe()\n",
    )
    ended = run("greedy_command", tmp_path)
    assert ended.returncode == LACKING
    assert ended.stderr == b"error: a file, a pipe or a process: Too many open files\n"


AGAIN = os.strerror(errno.EAGAIN)


@pytest.mark.parametrize(
    "failure",
    ["BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))", 'RuntimeError("can\'t start new thread")'],
)
def test_too_few_processes_are_one_line(written, tmp_path, failure):
    written("crowded_command", f"import errno, os\nraise {failure}")
    ended = run("crowded_command", tmp_path)
    assert (ended.returncode, ended.stderr) == (LACKING, f"error: a process or a thread: {AGAIN}\n".encode())


@pytest.mark.parametrize(
    ("kind", "most", "said"),
    [
        (resource.RLIMIT_AS, ADDRESSES_MIN - 1, "-v: found 1048575 KiB, expected at least 1048576 KiB"),
        (resource.RLIMIT_AS, 0, "-v: found 0 KiB, expected at least 1048576 KiB"),
        (resource.RLIMIT_STACK, STACK_MIN - 1, "-s: found 1023 KiB, expected at least 1024 KiB"),
    ],
)
def test_a_limit_of_memory_that_is_too_low_is_one_line(capsys, monkeypatch, kind, most, said):
    monkeypatch.setattr(
        resource, "getrlimit", lambda asked: [most if asked == kind else resource.RLIM_INFINITY] * 2
    )
    with pytest.raises(SystemExit) as caught:
        start("no_such_command")
    assert caught.value.code == LACKING
    assert capsys.readouterr().err == f"error: ulimit {said}\n"


def test_the_least_memory_is_enough(written, monkeypatch, capsys, begun):
    written("small_command", "def cli():\n    print('ran')\n")
    least = {resource.RLIMIT_AS: ADDRESSES_MIN, resource.RLIMIT_STACK: STACK_MIN}
    monkeypatch.setattr(resource, "getrlimit", lambda asked: [least[asked]] * 2)
    begun("small_command")
    assert capsys.readouterr().out == "ran\n"


def test_children_write_utf_8_whatever_this_process_writes(written, tmp_path):
    child = "subprocess.check_output([sys.executable, '-c', r'print(chr(181))'])"
    written("parent_command", f"import subprocess, sys\ndef cli():\n    print({child})\n")
    ended = run("parent_command", tmp_path, PYTHONIOENCODING="utf-16")
    assert (ended.returncode, ended.stderr) == (0, b"")
    assert ended.stdout.decode("utf-16") == "b'\\xc2\\xb5\\n'\n"


BLOCKED = """
import os
from threading import Timer

from deploy.command_line import main

def fill() -> int:
    Timer(0.2, os.kill, (os.getpid(), int(os.environ["SIGNAL"]))).start()
    print("x" * int(os.environ["LETTERS"]))
    return 0

def cli():
    main(fill)
"""


@pytest.mark.parametrize("letters", [100, 1_000_000])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_one_signal_ends_a_command_that_waits_for_the_reader_of_its_output(
    written, tmp_path, number, letters
):
    """In a write, or in that of what is left in a buffer at the end."""
    written("blocked_command", BLOCKED)
    reader, writer = os.pipe()
    with open(reader, "rb"), open(writer, "wb") as pipe:
        os.set_blocking(writer, False)
        with contextlib.suppress(BlockingIOError):
            while True:
                os.write(writer, b"x" * 512)
        os.set_blocking(writer, True)
        environment = {"SIGNAL": str(int(number)), "LETTERS": str(letters)}
        ended = run("blocked_command", tmp_path, stdout=pipe, stderr=pipe, **environment)
    assert ended.returncode == INTERRUPTED
