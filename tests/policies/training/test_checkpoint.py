import os
import pickle
import zipfile

import pytest

torch = pytest.importorskip("torch")

from functools import partial

from policies.training.checkpoint import load_checkpoint
from robots.errors import ContractError, OutputError
from support.checkpoints import made_actor, saved
from support.contracts import arm_contract
from support.refusals import refusal

pytestmark = pytest.mark.slow


def test_checkpoint_round_trips(tmp_path):
    actor = made_actor()
    found = load_checkpoint(saved(tmp_path, actor=actor))
    assert (found.contract, found.seed, found.recipe) == (arm_contract(), 3, "steps = 1\n")
    assert found.rollout.shape == (1100, 30)
    assert torch.equal(found.actor(found.rollout), actor(found.rollout))


def test_the_same_checkpoint_is_the_same_bytes(tmp_path):
    assert saved(tmp_path, name="a.pt").read_bytes() == saved(tmp_path, name="b.pt").read_bytes()


# ---- files that are not checkpoints ----


class Evil:
    def __init__(self, witness):
        self.witness = witness

    def __reduce__(self):
        return os.mkdir, (str(self.witness),)


refused = partial(refusal, load_checkpoint, lines=3)


def test_a_malicious_pickle_is_named_and_never_run(tmp_path):
    witness, path = tmp_path / "witness", tmp_path / "evil.pt"
    file = torch.load(saved(tmp_path), weights_only=True)
    torch.save({**file, "recipe": Evil(witness)}, path)
    message = refused(path)
    assert message.startswith("data.pkl: found 'posix.mkdir', expected only tensors, numbers and text")
    assert not witness.exists()
    torch.load(path, weights_only=False)  # the trap was armed
    assert witness.exists()


def test_a_bare_pickle_is_never_run(tmp_path):
    witness, path = tmp_path / "witness", tmp_path / "evil.pt"
    path.write_bytes(pickle.dumps(Evil(witness)))
    assert (
        refused(path)
        == "found no archive that can be read: a BadZipFile, expected a checkpoint of policy-train"
    )
    assert not witness.exists()


def test_a_whole_module_is_refused(tmp_path):
    torch.save(made_actor(), tmp_path / "x.pt")
    assert refused(tmp_path / "x.pt").startswith("data.pkl: found 'policies.training.networks.Actor'")


def zipped(path, **records):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in records.items():
            archive.writestr(f"archive/{name}", data)


def test_other_files_are_refused(tmp_path):
    path = tmp_path / "x.pt"
    assert refused(path).startswith("cannot be read: No such file or directory")
    assert refused(tmp_path).startswith("cannot be read: Is a directory")
    for data in (b"", b"junk" * 100, saved(tmp_path).read_bytes()[:-300]):
        path.write_bytes(data)
        assert (
            refused(path)
            == "found no archive that can be read: a BadZipFile, expected a checkpoint of policy-train"
        )
    zipped(path, note="hello")
    assert refused(path).startswith(
        "found no data.pkl in little-endian byte order, expected a checkpoint of policy-train"
    )


def test_a_bomb_is_not_unpacked(tmp_path, monkeypatch):
    monkeypatch.setattr("policies.importers.untrusted.zip_archive.BYTES_MAX", 10**6)
    zipped(tmp_path / "x.pt", data=bytes(10**6 + 1))
    assert (tmp_path / "x.pt").stat().st_size < 10**4
    assert refused(tmp_path / "x.pt") == "found 1000001 bytes unpacked, expected at most 1000000"


# ---- checkpoints with something wrong in them ----


def edited(folder, change):
    path = saved(folder)
    file = torch.load(path, weights_only=True)
    change(file)
    torch.save(file, path)
    return path


def put(*keys, value):
    def change(file):
        for key in keys[:-1]:
            file = file[key]
        file[keys[-1]] = value

    return change


def spoil(key, index, value):
    def change(file):
        tensor = file["rollout"] if key == "rollout" else file["actor"][key]
        tensor[index] = value

    return change


WEIGHT = "mlp.2.weight"
BAD = {
    "unknown key": (put("optimizer", value={}), "optimizer: Extra inputs are not permitted"),
    "missing key": (lambda file: file.pop("rollout"), "rollout: Field required"),
    "other format": (put("format", value=2), "format: Input should be 1, found 2"),
    "other activation": (put("activation", value="relu"), "activation: Input should be 'elu', found 'relu'"),
    "tensor for text": (put("contract", value=torch.zeros(2)), "contract: Input should be a valid string"),
    "number for tensor": (
        put("actor", WEIGHT, value=1.0),
        f"actor.{WEIGHT}: Input should be an instance of Tensor",
    ),
    "no layers": (put("layers", value=[]), "layers: Tuple should have at least 1 item"),
    "layer of a million": (
        put("layers", value=[10**6]),
        "layers.0: Input should be less than or equal to 4096",
    ),
    "other layers": (
        put("layers", value=[32, 17]),
        "actor.mlp.2.weight: found torch.float32 (16, 32) contiguous, expected torch.float32 (17, 32)",
    ),
    "more layers": (
        put("layers", value=[32, 16, 8]),
        "actor: found tensors ['divisor', 'mean', 'mlp.0.bias'",
    ),
    "tensor missing": (
        lambda file: file["actor"].pop("mean"),
        "actor: found tensors ['divisor', 'mlp.0.bias'",
    ),
    "double": (
        put("actor", "mean", value=torch.zeros(30, dtype=torch.float64)),
        "actor.mean: found torch.float64 (30,) contiguous, expected torch.float32 (30,) contiguous",
    ),
    "claims to be huge": (
        put("rollout", value=torch.zeros(1).expand(10**12, 30)),
        "rollout: found 1000000000000 observations, expected from 1000 to 4096",
    ),
    "one number for all": (
        put("rollout", value=torch.zeros(1).expand(1000, 30)),
        "rollout: found torch.float32 (1000, 30) not contiguous, expected",
    ),
    "strided": (
        put("actor", "mean", value=torch.zeros(30, 2)[:, 0]),
        "actor.mean: found torch.float32 (30,) not",
    ),
    "weight NaN": (
        spoil(WEIGHT, (0, 3), torch.nan),
        f"actor.{WEIGHT}: found 1 values NaN or infinite, expected all",
    ),
    "mean infinite": (
        spoil("mean", 3, -torch.inf),
        "actor.mean: found 1 values NaN or infinite, expected all finite",
    ),
    "divisor of zero": (spoil("divisor", 3, 0.0), "actor.divisor: found 0, expected all above 0"),
    "rollout NaN": (
        spoil("rollout", (5, 3), torch.nan),
        "rollout: found 1 values NaN or infinite, expected all",
    ),
    "rollout short": (
        put("rollout", value=torch.zeros(999, 30)),
        "rollout: found 999 observations, expected from 1000 to 4096",
    ),
    "rollout long": (
        put("rollout", value=torch.zeros(4097, 30)),
        "rollout: found 4097 observations, expected from 1000 to 4096",
    ),
    "rollout narrow": (
        put("rollout", value=torch.zeros(1000, 29)),
        "rollout: found torch.float32 (1000, 29) contiguous, expected torch.float32 (1000, 30) contiguous",
    ),
    "rollout a number": (
        put("rollout", value=torch.tensor(1.0)),
        "rollout: found 0 observations, expected from 1000 to 4096",
    ),
    "contract broken": (put("contract", value="{"), "contract: not valid JSON"),
    "seed as text": (put("seed", value="3"), "seed: Input should be a valid integer, found '3'"),
    "seed without end": (
        put("seed", value=torch.zeros(1).as_strided((2,) * 40, (0,) * 40)),
        "seed: Input should be a valid integer, found a Tensor",
    ),
}


@pytest.mark.parametrize(("change", "message"), BAD.values(), ids=BAD)
def test_a_bad_key_is_named(tmp_path, change, message):
    assert refused(edited(tmp_path, change)).startswith(message)


def test_list_is_refused(tmp_path):
    torch.save([torch.zeros(2)], tmp_path / "x.pt")
    assert refused(tmp_path / "x.pt").startswith("(whole file): Input should be a valid dictionary")


# ---- what save refuses ----


def test_unloadable_checkpoint_is_not_saved(tmp_path):
    path = saved(tmp_path)
    before = path.read_bytes()
    actor = made_actor(1)
    actor.mean[0] = torch.nan
    with pytest.raises(ContractError, match=r"actor\.mean: found 1 values NaN"):
        saved(tmp_path, actor=actor)
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == ["arm.pt"]


def test_an_unwritable_place_is_named(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(OutputError) as caught:
        saved(tmp_path / "file")
    assert str(caught.value) == f"--out {tmp_path / 'file' / 'arm.pt'}: cannot be written: Not a directory"
