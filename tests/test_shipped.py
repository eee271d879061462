import pytest
from test_spec import SPEC

pytest.importorskip("torch")

from deploy.policy import Policy
from policies.checkpoint import load_checkpoint
from policies.export import POLICIES, export
from policies.recipe import contract_of, find_recipe, load_recipe

CHECKPOINTS = sorted(POLICIES.glob("*.pt"))


def test_a_checkpoint_is_shipped():
    assert [path.name for path in CHECKPOINTS] == ["arm.pt"]


@pytest.mark.parametrize("path", CHECKPOINTS, ids=lambda path: path.stem)
def test_a_shipped_checkpoint_was_made_by_the_shipped_recipe(path):
    checkpoint, recipe = load_checkpoint(path), find_recipe(path.stem)
    assert checkpoint.recipe == recipe.read_text(encoding="utf-8")
    settings = load_recipe(recipe)
    assert checkpoint.seed == settings.seed
    assert checkpoint.contract == contract_of(settings, SPEC, checkpoint.contract.trained)


@pytest.mark.parametrize("path", CHECKPOINTS, ids=lambda path: path.stem)
def test_a_shipped_checkpoint_exports_and_loads(path, tmp_path):
    exported = export(path, tmp_path / "policy.onnx")
    assert exported.observations >= 1000
    assert max(exported.deviation) <= 1e-5
    assert Policy.load(exported.path, SPEC).digest == exported.digest
