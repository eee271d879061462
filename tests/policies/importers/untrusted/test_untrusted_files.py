"""Files that were made to do harm, or that a disk has spoiled: one clear error, and nothing else happens."""

import errno
import io
import os
import pickle
import random
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from onnx import TensorProto, helper, numpy_helper

torch = pytest.importorskip("torch")
pytest.importorskip("onnxscript")
pytest.importorskip("rsl_rl.models")

from policies.importers.readers import read_policy
from policies.importers.torch_files.network_settings import NetworkSettings
from policies.importers.untrusted import zip_archive
from robots import archives
from robots.errors import ContractError
from support.importers.exported_programs import saved as saved_program
from support.importers.imports import exported
from support.importers.rsl_rl_files import KINDS, saved
from support.importers.torch_files import Recurrent, members, mlp, saved_script
from support.paths import ROOT

pytestmark = pytest.mark.slow

ELU, ASKED = NetworkSettings(activation="elu", normalizer="none"), NetworkSettings(normalizer="none")
LINES_MAX, CHARACTERS_MAX = 5, 1200


def stable_baselines(folder):
    stable = pytest.importorskip("support.importers.stable_baselines")
    return stable.saved(folder, policy_kwargs=stable.SMALL)[2]


def state_dict(folder):
    torch.save(mlp().state_dict(), folder / "weights.pt")
    return folder / "weights.pt"


FILES = {
    "rsl_rl": lambda folder: saved(folder, **KINDS["MLP"])[0],
    "Stable-Baselines3": stable_baselines,
    "state_dict": state_dict,
    "TorchScript": lambda folder: saved_script(folder / "motion.pt", Recurrent().eval()),
    "torch.export": saved_program,
    "ONNX": lambda folder: exported(folder, "mlp")[0],
}


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A good file of each kind."""
    return {kind: make(tmp_path_factory.mktemp("good")) for kind, make in FILES.items()}


def answers(path):
    return ASKED if path.suffix == ".zip" else ELU


READERS = {
    "state_dict": "policies.importers.torch_files.state_dict.read_state_dict",
    "ONNX": "policies.importers.readers.read_onnx",
}


def raising(error):
    """A reader that fails."""

    def fail(*_):
        raise error

    return fail


def refused(path):
    """The message, if it is one that a person can read."""
    with pytest.raises(ContractError) as caught:
        read_policy(path, answers(path))
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert message.count("\n") < LINES_MAX
    assert len(message) < CHARACTERS_MAX
    assert message.replace("\n", "").isprintable()
    return message.removeprefix(f"{path}: ")


def zipped(contents, compression=zipfile.ZIP_STORED):
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", compression) as archive:
        for name, data in contents.items():
            archive.writestr(name, data)
    return stream.getvalue()


# ---- spoiled files ----


def spoiled(data, rng):
    """Cut, repeated in part, or with other bytes in some places."""
    way = rng.random()
    if way < 0.15:
        return data[: rng.randrange(len(data))]
    if way < 0.25:
        place = rng.randrange(len(data))
        return data[:place] + data[max(0, place - rng.randrange(60)) :]
    spoilt = bytearray(data)
    for _ in range(rng.choice([1, 1, 2, 4, 8])):
        spoilt[rng.randrange(len(spoilt))] = rng.choice([0, 1, 127, 128, 255, rng.randrange(256)])
    return bytes(spoilt)


def spoiled_inside(path, rng):
    """The same of one of an archive's members that holds more than weights, with an honest checksum."""
    found = members(path)
    name = rng.choice([name for name, data in found.items() if data and "/data/" not in name])
    return zipped(found | {name: spoiled(found[name], rng)})


@pytest.mark.parametrize("kind", FILES)
@settings(max_examples=8)
@given(seed=st.integers(0, 10**9), inside=st.booleans())
def test_damaged_file_is_read_or_refused_in_few_lines(files, kind, seed, inside):
    good, rng = files[kind], random.Random(seed)
    path = good.with_name(f"spoiled{good.suffix}")
    inside = inside and zipfile.is_zipfile(good)
    path.write_bytes(spoiled_inside(good, rng) if inside else spoiled(good.read_bytes(), rng))
    try:
        read_policy(path, answers(path))
    except ContractError:
        refused(path)


@pytest.mark.parametrize("kind", FILES)
def test_truncated_file_is_named_as_such(files, kind):
    good = files[kind]
    path = good.with_name(f"part{good.suffix}")
    path.touch()
    assert "found an empty file" in refused(path)
    path.write_bytes(good.read_bytes()[:600])
    archived = zipfile.is_zipfile(good)
    assert ("a truncated archive" in refused(path)) == archived


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (RecursionError("maximum depth"), "RecursionError: maximum depth"),
        (
            RuntimeError("[enforce fail]\nDefaultCPUAllocator"),
            "RuntimeError: [enforce fail] DefaultCPUAllocator",
        ),
        (AssertionError(), "AssertionError"),
        (KeyError("node"), "KeyError: 'node'"),
        (OSError(errno.EINVAL, "Invalid argument"), "OSError: [Errno 22] Invalid argument"),
    ],
)
@pytest.mark.parametrize("kind", ["state_dict", "ONNX"])
def test_whatever_a_reader_raises_names_the_file(files, monkeypatch, kind, error, message):
    monkeypatch.setattr(READERS[kind], raising(error))
    assert refused(files[kind]) == f"cannot be read: {message}"


@pytest.mark.parametrize(
    "error",
    [MemoryError(), ImportError("onnxscript"), OSError(errno.EMFILE, "Too many"), KeyboardInterrupt()],
)
def test_what_the_computer_lacks_is_not_said_of_the_file(files, monkeypatch, error):
    monkeypatch.setattr(READERS["state_dict"], raising(error))
    with pytest.raises(type(error)):
        read_policy(files["state_dict"], ELU)


# ---- archives ----


def test_an_archive_that_unpacks_to_too_much_is_not_unpacked(tmp_path, files, monkeypatch):
    monkeypatch.setattr(zip_archive, "BYTES_MAX", 10**6)
    path = tmp_path / "x.pt"
    for kind in ("rsl_rl", "TorchScript", "torch.export"):
        found = members(files[kind])
        folder = next(iter(found)).partition("/")[0]
        path.write_bytes(zipped(found | {f"{folder}/data/0": bytes(10**7)}, zipfile.ZIP_DEFLATED))
        assert "bytes unpacked, expected at most 1000000" in refused(path)
    path.write_bytes(bytes(10**6 + 1))
    assert refused(path).startswith("found 1000001 bytes, at most 1000000, expected a policy")


def test_false_size_in_an_archive_is_detected(tmp_path, files):
    data = bytearray(
        zipped(members(files["state_dict"]) | {"weights/data/0": bytes(10**7)}, zipfile.ZIP_DEFLATED)
    )
    table = data.rindex(b"weights/data/0") - 46
    assert data[table : table + 4] == archives.RECORD
    data[table + 24 : table + 28] = (448).to_bytes(4, "little")
    (tmp_path / "x.pt").write_bytes(data)
    assert refused(tmp_path / "x.pt").startswith("found no archive that can be read: a BadZipFile")


def test_an_archive_of_more_members_than_a_policy_has_is_not_listed(tmp_path):
    path = tmp_path / "x.pt"
    path.write_bytes(zipped({f"x/{k}": b"" for k in range(archives.MEMBERS_MAX + 1)}))
    assert refused(path) == "found 10001 members, expected at most 10000"


@pytest.mark.parametrize("compression", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_other_compressions_are_refused_since_nothing_bounds_them(tmp_path, files, compression):
    path = tmp_path / "x.pt"
    for kind in ("rsl_rl", "Stable-Baselines3", "TorchScript", "torch.export"):
        path.write_bytes(zipped(members(files[kind]), compression))
        assert f"found compression {compression}, expected none" in refused(path)


def test_an_archive_is_packed_anew_whatever_the_clock_says(monkeypatch):
    packed = zip_archive.repack({"a": b"1"}).getvalue()
    monkeypatch.setattr(zipfile.time, "time", lambda: 0.0)
    assert zip_archive.repack({"a": b"1"}).getvalue() == packed


ESCAPES = ("../escaped", "/tmp/escaped", "x/../../escaped", "x\\..\\escaped")


def test_members_that_would_escape_their_folder_are_written_nowhere(tmp_path, files):
    inner = tmp_path / "a" / "b"
    inner.mkdir(parents=True)
    for kind in ("rsl_rl", "Stable-Baselines3", "TorchScript", "torch.export"):
        path = inner / files[kind].name
        path.write_bytes(zipped(members(files[kind]) | dict.fromkeys(ESCAPES, b"x")))
        if kind == "Stable-Baselines3":  # has no outer folder
            assert read_policy(path, ASKED).facts.actions == 3
        else:
            assert refused(path) == "found 5 outer folders, expected one"
        assert [each for each in tmp_path.rglob("*") if each.is_file()] == [path]
        path.unlink()
    assert not Path("/tmp/escaped").exists()


def test_an_archive_inside_an_archive_is_not_opened(tmp_path, files):
    path = tmp_path / "x.pt"
    path.write_bytes(zipped({"x/x.pt": files["rsl_rl"].read_bytes()}))
    assert refused(path).startswith("found no data.pkl in little-endian byte order, expected a policy")


# ---- pickles ----


class Call:
    """What its pickle would do."""

    def __init__(self, function, *arguments):
        self.what = function, arguments

    def __reduce__(self):
        return self.what


def twice(depth):
    """A tuple of itself twice, and so on: a few hundred bytes, and more things than there are atoms."""
    value = ()
    for _ in range(depth):
        value = (value, value)
    return value


def pickled(folder, value, files):
    found = members(files["state_dict"])
    (folder / "x.pt").write_bytes(zipped(found | {"weights/data.pkl": pickle.dumps(value, 2)}))
    return folder / "x.pt"


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (Call(os.system, "touch escaped"), "data.pkl: found 'posix.system', expected only tensors, numbers"),
        (Call(bytearray, 1 << 34), "data.pkl: found '__builtin__.bytearray', expected only tensors"),
        (Call(torch.Tensor, 1 << 40), "data.pkl: found 'torch.Tensor', expected only tensors"),
        (Call(eval, "1"), "data.pkl: found '__builtin__.eval', expected only tensors"),
        ({"a": twice(200)}, "data.pkl: corrupt: a OverflowError"),
    ],
)
def test_pickled_code_is_not_run(tmp_path, files, monkeypatch, value, message):
    monkeypatch.chdir(tmp_path)
    assert refused(pickled(tmp_path, value, files)).startswith(message)
    assert os.listdir(tmp_path) == ["x.pt"]


@pytest.mark.parametrize("protocol", [0, 1, 3, 4, 5])
def test_code_is_found_in_pickles_of_any_age(tmp_path, files, protocol):
    found = members(files["state_dict"])
    code = pickle.dumps(Call(os.mkdir, str(tmp_path / "escaped")), protocol)
    (tmp_path / "x.pt").write_bytes(zipped(found | {"weights/data.pkl": code}))
    assert "nothing of it was run" in refused(tmp_path / "x.pt")
    assert os.listdir(tmp_path) == ["x.pt"]


def test_tensors_beyond_their_storage_are_refused(tmp_path, files):
    found = members(files["state_dict"])
    (tmp_path / "x.pt").write_bytes(zipped(found | {"weights/data/0": found["weights/data/0"][:8]}))
    assert refused(tmp_path / "x.pt") == "data.pkl: corrupt: a RuntimeError"
    huge = {"0.weight": torch.zeros(1).expand(4096, 4096), "0.bias": torch.zeros(1).expand(4096)}
    torch.save(huge, tmp_path / "x.pt")
    assert "expected torch.float32 (4096, 4096) contiguous" in refused(tmp_path / "x.pt")


# ---- ONNX ----


def graph(*nodes, held=(), observations=(1, 3), actions=(1, 3)):
    ends = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)
        for name, shape in (("obs", observations), ("actions", actions))
    ]
    weights = [numpy_helper.from_array(np.array(value), name) for name, value in held]
    made = helper.make_graph(list(nodes), "policy", [ends[0]], [ends[1]], weights)
    return helper.make_model(made, opset_imports=[helper.make_opsetid("", 18)], ir_version=9)


def node(kind, inputs, outputs, **attributes):
    return helper.make_node(kind, inputs.split(), outputs.split(), **attributes)


def custom():
    model = graph(node("Evil", "obs", "actions", domain="com.microsoft"))
    model.opset_import.append(helper.make_opsetid("com.microsoft", 1))
    return model


def endless():
    body = helper.make_graph(
        [node("Identity", "going", "goes")],
        "forever",
        [
            helper.make_tensor_value_info("count", TensorProto.INT64, []),
            helper.make_tensor_value_info("going", TensorProto.BOOL, []),
        ],
        [helper.make_tensor_value_info("goes", TensorProto.BOOL, [])],
    )
    return graph(
        node("Loop", "many on", "", body=body),
        node("Identity", "obs", "actions"),
        held=[("many", 1 << 62), ("on", True)],
    )


def words():
    return graph(
        node("Identity", "word", "said"),
        node("Identity", "obs", "actions"),
        held=[("word", ["a" * 1000] * 1000)],
    )


def elsewhere(where, **more):
    def make():
        model = graph(node("Add", "obs w", "actions"), held=[("w", np.ones((1, 3), np.float32))])
        weight = model.graph.initializer[0]
        weight.ClearField("raw_data")
        weight.data_location = TensorProto.EXTERNAL
        for key, value in {"location": where, **more}.items():
            weight.external_data.add(key=key, value=str(value))
        return model

    return make


def unknown_numbers():
    model = graph(node("Identity", "obs", "actions"))
    model.graph.input[0].type.tensor_type.elem_type = 64
    return model


def claiming():
    model = graph(node("Add", "obs w", "actions"), held=[("w", np.ones((1, 3), np.float32))])
    model.graph.initializer[0].dims[:] = [1 << 40, 1 << 20]
    return model


ONNX = {
    "own operator": (custom, "operator domain: found 'com.microsoft', expected only ai.onnx"),
    "loop": (endless, "node '': found Loop with a graph of its own, expected none"),
    "many words": (words, None),
    "words for actions": (
        lambda: graph(node("Identity", "word", "actions"), held=[("word", [["a", "b", "c"]])]),
        "output 'actions': does not depend on 'obs', expected an action computed from the observation",
    ),
    "above its folder": (
        elsewhere("../../etc/passwd"),
        "tensor 'w': found its weights in '../../etc/passwd'",
    ),
    "of the system": (elsewhere("/etc/passwd"), "tensor 'w': found its weights in '/etc/passwd'"),
    "a link": (elsewhere("link"), "tensor 'w': found its weights in 'link', expected a file beside x.onnx"),
    "no offset": (elsewhere("beside", offset="x"), "tensor 'w': found invalid literal for int()"),
    "before its beginning": (
        elsewhere("beside", offset=-1, length=12),
        "tensor 'w': found [Errno 22] Invalid",
    ),
    "past its end": (elsewhere("beside", length=1 << 40), "tensor 'w': found 0 bytes in 'beside', expected"),
    "no words": (elsewhere("beside\x00"), "tensor 'w': found its weights in 'beside\\x00'"),
    "huge": (claiming, ""),
    "unknown numbers": (unknown_numbers, "'obs': found kind 64 (1, 3), expected FLOAT with 1 to 4096"),
    "huge observations": (
        lambda: graph(node("Identity", "obs", "actions"), observations=(1, 1 << 40), actions=(1, 1 << 40)),
        "'obs': found FLOAT (1, 1099511627776), expected FLOAT with 1 to 4096 numbers",
    ),
}


@pytest.mark.parametrize("kind", ONNX)
def test_graph_beyond_arithmetic_is_refused(tmp_path, kind):
    make, message = ONNX[kind]
    path = tmp_path / "x.onnx"
    (tmp_path / "beside").write_bytes(bytes(12))
    (tmp_path / "link").symlink_to("/etc/passwd")
    path.write_bytes(make().SerializeToString())
    if message is None:  # what the action does not depend on is left out
        assert read_policy(path, answers(path)).facts.actions == 3
    else:
        assert refused(path).startswith(message)


def test_repeated_weights_are_read_up_to_the_file_limit(tmp_path, monkeypatch):
    monkeypatch.setattr("policies.importers.onnx_files.foreign_onnx.BYTES_MAX", 1000)
    model = elsewhere("beside")()
    for k in range(9):
        model.graph.initializer.add().CopyFrom(model.graph.initializer[0])
        model.graph.initializer[-1].name = f"w{k}"
    (tmp_path / "beside").write_bytes(bytes(300))
    (tmp_path / "x.onnx").write_bytes(model.SerializeToString())
    found = refused(tmp_path / "x.onnx")
    assert found == "tensor 'w2': found 0 bytes in 'beside', expected 300, 100 at most"


# ---- what only running it shows ----

SCRIPT = """
import sys
from policies.importers.untrusted.watched_process import run_watched
def command():  # its limits alone, the last line of defence
    from deploy.policy import graph_bounds, step_trial
    from deploy.start import start
    from policies.importers.untrusted import resource_limits
    for name in ("ELEMENTS_MAX", "BYTES_MAX", "WORK_MAX", "TRIPS_MAX"):
        setattr(graph_bounds, name, 1 << 99)
    step_trial.try_step = lambda *_, **__: 0.0
    resource_limits.MEMORY_GIB = 4
    start("policies.importers.cli")
run_watched(command, float(sys.argv.pop()))
"""


def command(path, seconds):
    """The command in a process of its own: exit code, and what it said."""
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(path), "--template", str(seconds)],
        capture_output=True,
        text=True,
        check=False,
        cwd=path.parent,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    return done.returncode, done.stderr


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux bounds the memory of a process")
def test_graph_that_needs_all_memory_is_refused(tmp_path):
    path = tmp_path / "x.onnx"
    model = graph(
        node("ConstantOfShape", "shape", "big"),
        node("ReduceSum", "big", "sum", keepdims=0),
        node("Add", "obs sum", "actions"),
        held=[("shape", np.array([1 << 17, 1 << 17]))],
    )
    path.write_bytes(model.SerializeToString())
    code, said = command(path, 300)
    assert code == 2
    assert said.startswith(f"error: {path}: cannot be ")
    assert said.count("\n") == 1


def test_endless_graph_is_refused(tmp_path):
    path = tmp_path / "x.onnx"
    body = helper.make_graph(
        [node("Identity", "known", "knows")],
        "forever",
        [
            helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)
            for name, shape in (("known", [1, 3]), ("row", [0]))
        ],
        [helper.make_tensor_value_info("knows", TensorProto.FLOAT, [1, 3])],
    )
    many = numpy_helper.from_array(np.zeros((1, 0), np.float32), "many")
    model = graph(node("Scan", "obs many", "actions", body=body, num_scan_inputs=1))
    model.graph.initializer.append(many)
    model.graph.initializer[0].dims[0] = 1 << 40
    path.write_bytes(model.SerializeToString())
    code, said = command(path, 8)
    assert (code, said) == (2, f"error: {path} --template: not finished after 8 s\n")
    assert os.listdir(tmp_path) == ["x.onnx"]
