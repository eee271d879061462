"""The step of a policy, tried in a process of its own."""

import errno
import json
import os
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from onnx import TensorProto, helper, numpy_helper

import deploy.operation.cli
from deploy.policy import step_trial
from deploy.policy.inference import load_session
from deploy.policy.policy_names import GOLDEN_KEY
from deploy.policy.step_trial import check_step, median_step_s, run_golden_pairs, try_step
from robots.child_process import ENDED, Lifeline
from robots.errors import ContractError
from support.graphs import graph, node
from support.policies import metadata, policy_model, saved
from support.processes import NO_THREADS
from support.recurrent_policies import remembering


def slow(elements=1 << 23):
    """The small policy, which takes the sines of millions of numbers on the way: less than the static bound."""
    model = policy_model()
    model.graph.node[-1].output[0] = "raw"
    for kind, inputs, output, more in (
        ("ReduceMax", ["observation"], "one", {"keepdims": 0}),
        ("Expand", ["one", "wide"], "many", {}),
        ("Sin", ["many"], "waves", {}),
        ("ReduceMin", ["waves"], "least", {"keepdims": 0}),
        ("Mul", ["least", "zero"], "nothing", {}),
        ("Add", ["raw", "nothing"], "action", {}),
    ):
        model.graph.node.append(helper.make_node(kind, inputs, [output], **more))
    for name, array in (("wide", np.array([elements])), ("zero", np.zeros((), np.float32))):
        model.graph.initializer.append(numpy_helper.from_array(array, name))
    return model


def test_a_small_policy_takes_a_small_part_of_its_period():
    data = policy_model().SerializeToString()
    check_step(data, 0.02, "x.onnx")
    assert 0.0 < median_step_s(load_session(data, "x.onnx"), "x.onnx") < 0.01


def test_a_policy_that_is_too_slow_is_refused_before_anything_moves(call, tmp_path):
    out = tmp_path / "out"
    path = saved(slow(), tmp_path)
    code, said, complaint = call(deploy.operation.cli.cli, "--policy", path, "--out", out)
    assert (code, said) == (2, "")
    assert complaint.startswith(f"error: {path}: a step takes ")
    assert complaint.endswith("ms on this machine, expected at most 10 ms, 0.5 of the policy's period\n")
    assert not out.exists()


def failing_far_away(memory):
    """A policy that ONNX Runtime cannot run at an observation above 1000, with a golden pair there."""
    model = remembering() if memory else policy_model()
    source = next(node for node in model.graph.node if "action" in node.output)
    source.output[0] = "raw"
    for kind, inputs, output, more in (
        ("ReduceMax", ["observation"], "most", {"keepdims": 0}),
        ("Div", ["most", "thousand"], "share", {}),
        ("Cast", ["share"], "place", {"to": TensorProto.INT64}),
        ("Gather", ["zero", "place"], "nothing", {}),
        ("Add", ["raw", "nothing"], "action", {}),
    ):
        model.graph.node.append(helper.make_node(kind, inputs, [output], **more))
    for name, array in (("thousand", np.float32(1000.0)), ("zero", np.zeros(1, np.float32))):
        model.graph.initializer.append(numpy_helper.from_array(np.asarray(array), name))
    pairs = json.loads(metadata(model, GOLDEN_KEY).value)
    pairs["observation"][-1][0] = 5000.0
    metadata(model, GOLDEN_KEY).value = json.dumps(pairs)
    return model


@pytest.mark.parametrize("memory", [False, True])
def test_golden_pairs_are_tried_too(memory):
    data = failing_far_away(memory).SerializeToString()
    assert try_step(data, "x.onnx") > 0.0
    with pytest.raises(
        ContractError, match=r"^x\.onnx: cannot be run at batch 1: .*indices element out of data bounds"
    ):
        check_step(data, 0.02, "x.onnx")


@pytest.mark.parametrize("memory", [False, True])
def test_golden_pairs_are_run_as_their_verification_does(memory):
    """The same observations in the same order, for one robot and for many."""
    model = remembering() if memory else policy_model()
    session, asked = load_session(model.SerializeToString(), "x.onnx"), []

    def run(names, inputs):
        asked.append({name: array.copy() for name, array in inputs.items()})
        return session.run(names, inputs)

    others = {name: getattr(session, name) for name in ("get_inputs", "get_outputs", "get_modelmeta")}
    run_golden_pairs(SimpleNamespace(run=run, **others), (1, 5), "x.onnx")
    rows = np.array(json.loads(metadata(model, GOLDEN_KEY).value)["observation"], np.float32)
    if memory:
        expected = [*(row[None] for row in rows), *(np.repeat(row[None], 5, axis=0) for row in rows)]
    else:
        expected = [*(row[None] for row in rows), *np.resize(rows, (20, rows.shape[1])).reshape(4, 5, -1)]
    for inputs, observation in zip(asked, expected, strict=True):
        np.testing.assert_array_equal(inputs["observation"], observation)
    if memory:
        assert (asked[0]["memory"] == 0).all()
        assert (asked[len(rows)]["memory"] == 0).all()
        assert (asked[1]["memory"] != 0).any()


USED = "int(next(line.split()[1] for line in open('/proc/self/status') if line.startswith('VmData'))) << 10"
LEFT = f"({USED}) + (16 << 20)"
LOWER = {
    "memory": f"resource.setrlimit(resource.RLIMIT_DATA, ({LEFT}, {LEFT}))",
    "time": "step_trial.CPU_S = 0",
}
"""Lower bounds: a model that passes the static bounds does not reach those of a trial."""


def start_with(monkeypatch, folder, *lines):
    """Let a script of these lines start in place of the trial."""
    starter, run = folder / "starter.py", subprocess.run
    starter.write_text("\n".join(lines))
    monkeypatch.setattr(
        subprocess, "run", lambda child, **more: run([child[0], str(starter), *child[4:]], **more)
    )


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux bounds the memory of a process")
@pytest.mark.parametrize(
    ("bound", "ending"),
    [("memory", "cannot be run at batch 1: .*memory"), ("time", "cannot be tried within .*exit code -")],
)
def test_a_policy_beyond_the_bounds_of_the_trial_is_refused(monkeypatch, tmp_path, bound, ending):
    lines = "import resource, sys", "from deploy.policy import step_trial", LOWER[bound]
    start_with(monkeypatch, tmp_path, *lines, "sys.exit(step_trial._main(*sys.argv[1:]))")
    with pytest.raises(ContractError, match=rf"^x\.onnx: {ending}"):
        check_step(slow().SerializeToString(), 0.02, "x.onnx")


def test_a_trial_that_somebody_has_stopped_is_killed(monkeypatch, tmp_path):
    """SIGSTOP: no alarm reaches it."""
    start_with(monkeypatch, tmp_path, "import os, signal", "os.kill(os.getpid(), signal.SIGSTOP)")
    monkeypatch.setattr(step_trial, "WALL_S", 1)
    monkeypatch.setattr(step_trial, "GRACE_S", 0.0)
    with pytest.raises(ContractError, match=r"^x\.onnx: cannot be tried within .*: not finished after 1 s$"):
        check_step(b"", 0.02, "x.onnx")


def test_a_trial_without_a_thread_says_nothing_about_the_policy(monkeypatch, tmp_path):
    start_with(monkeypatch, tmp_path, NO_THREADS, "from robots.child_process import end_with", "end_with(0)")
    with pytest.raises(BlockingIOError, match=os.strerror(errno.EAGAIN)):
        check_step(b"", 0.02, "x.onnx")


def test_memory_and_work_are_bounded_for_the_given_numbers_of_robots():
    """A graph for one robot, which has no step for two."""
    model = graph(node("Add", "x w", "y"), held={"w": np.zeros((3, 3), np.float32)})
    data = model.SerializeToString()
    assert try_step(data, "x.onnx", batches=(1,)) > 0.0
    with pytest.raises(ContractError, match=r"^x\.onnx: for a batch of 2: node 'y' \(Add\): shapes cannot"):
        try_step(data, "x.onnx", batches=(2,))


def test_what_the_trial_refuses_is_said_in_its_words():
    with pytest.raises(ContractError, match=r"^x\.onnx: not an ONNX file: its 4 bytes cannot be decoded: "):
        check_step(b"text", 0.02, "x.onnx")


def test_the_trial_ends_with_its_parent():
    lifeline = Lifeline()
    lifeline.cut()
    end = lifeline.end.fileno()
    command = [sys.executable, "-P", "-m", "deploy.policy.step_trial", "x.onnx", str(end)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, pass_fds=(end,)) as child:
        assert child.wait(60.0) == ENDED  # it still waits for the policy
