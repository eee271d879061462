import json
import os
import signal
import subprocess
import sys
import textwrap

# Tests send it to themselves, under nohup as well.
signal.signal(signal.SIGHUP, signal.SIG_DFL)

# Threads of torch that wait for each other sleep: otherwise they take the cores from other tests' processes.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

# Tests import ONNX Runtime by themselves.
os.environ["ORT_DISABLE_TELEMETRY"] = "1"

import numpy as np
import pytest

pytest.register_assert_rewrite("support")

from hypothesis import settings
from onnx import numpy_helper

from deploy.policy.policy_names import GOLDEN_KEY
from support.policies import A, golden, metadata, policy_model, saved, tensor, weights
from support.shared import made_once

# Cases are the same for everybody, and none fails for a slow machine.
settings.register_profile("same", derandomize=True, deadline=None)
settings.load_profile("same")


@pytest.fixture(scope="session")
def arm_policy(tmp_path_factory):
    """A valid policy file for the arm that asks for nothing."""
    model, still = policy_model(), golden(weights())
    for name in ("w1", "b1"):
        zeros = np.zeros_like(numpy_helper.to_array(tensor(model, name)))
        tensor(model, name).CopyFrom(numpy_helper.from_array(zeros, name))
    still["action"] = np.zeros((len(still["action"]), A)).tolist()
    metadata(model, GOLDEN_KEY).value = json.dumps(still)
    return saved(model, tmp_path_factory.mktemp("policy"))


@pytest.fixture(scope="session")
def shipped_policy(tmp_path_factory):
    """The shipped checkpoint as policy-export leaves it."""
    pytest.importorskip("torch")
    pytest.importorskip("onnxscript")

    def make(folder):
        from policies.export.cli import POLICIES, export

        export(POLICIES / "arm.pt", folder / "arm.onnx")

    return made_once(tmp_path_factory, "shipped", make) / "arm.onnx"


@pytest.fixture
def call(monkeypatch, capsys):
    """Call a command line in this process: exit code, standard output and standard error."""

    def call(cli, *arguments):
        capsys.readouterr()  # what was printed before
        monkeypatch.setattr(sys, "argv", ["command", *map(str, arguments)])
        with pytest.raises(SystemExit) as caught:
            cli()
        return caught.value.code, *capsys.readouterr()

    return call


@pytest.fixture
def crashing_trial(monkeypatch):
    """Let a policy crash the process in which it is tried; return what is said of it. It is loaded nowhere else."""
    run, crash = subprocess.run, "import os; os.kill(os.getpid(), 8)"

    def tried(child, **options):
        is_trial = "deploy.policy.step_trial" in child
        return run([child[0], "-c", crash] if is_trial else child, **options)

    monkeypatch.setattr(subprocess, "run", tried)
    monkeypatch.setattr("onnxruntime.InferenceSession", lambda *_, **__: pytest.fail("it was loaded"))
    return "cannot be tried within 20 s of a core and 4 GiB: exit code -8"


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """Install a distribution of one module with an entry point; return the folder of its module."""

    def install(module, text, group, entry):
        place = tmp_path / "site"
        info = place / f"{module}-1.0.dist-info"
        info.mkdir(parents=True)
        (place / f"{module}.py").write_text(textwrap.dedent(text))
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {module}\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(f"[firstshift.{group}]\n{entry}\n")
        monkeypatch.syspath_prepend(place)
        modules.append(module)
        return place

    modules = []
    yield install
    for module in modules:
        sys.modules.pop(module, None)
