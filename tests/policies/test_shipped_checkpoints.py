import pytest

pytest.importorskip("torch")

from deploy.policy.policy import Policy
from eval.shard.job import WIDTH, ShardJob
from eval.shard.shard import Shard
from policies.export.cli import POLICIES, export
from policies.training.checkpoint import load_checkpoint
from policies.training.recipe import contract_of, find_recipe, load_recipe
from robots.spec import load_robot

pytestmark = pytest.mark.slow

CHECKPOINTS = sorted(POLICIES.glob("*.pt"))


def test_checkpoints_are_shipped():
    assert [path.name for path in CHECKPOINTS] == ["arm.pt", "planar3_position.pt", "planar3_velocity.pt"]


def robot_of(path):
    return load_robot(load_checkpoint(path).contract.robot)


@pytest.mark.parametrize("path", CHECKPOINTS, ids=lambda path: path.stem)
def test_a_shipped_checkpoint_was_made_by_the_shipped_recipe(path):
    checkpoint, recipe = load_checkpoint(path), find_recipe(path.stem)
    assert checkpoint.recipe == recipe.read_text(encoding="utf-8")
    settings = load_recipe(recipe)
    assert checkpoint.seed == settings.seed
    assert checkpoint.contract == contract_of(settings, robot_of(path), checkpoint.contract.trained)


@pytest.mark.parametrize("path", CHECKPOINTS, ids=lambda path: path.stem)
def test_a_shipped_checkpoint_exports_and_loads(path, tmp_path):
    exported = export(path, tmp_path / "policy.onnx")
    assert exported.observations >= 1000
    assert max(exported.deviation) <= 1e-5
    assert Policy.load(exported.path, robot_of(path)).digest == exported.digest


@pytest.mark.parametrize("path", CHECKPOINTS, ids=lambda path: path.stem)
def test_shipped_checkpoint_reaches_its_goals(path, tmp_path):
    """Three goals each for one shard of robots that it never saw; what it is worth says a soak."""
    policy, spec = export(path, tmp_path / "policy.onnx").path, robot_of(path)
    job = ShardJob(
        robot=spec.folder,
        policy=policy,
        robot_digest=spec.digest,
        policy_digest=Policy.load(policy, spec).digest,
        seed=11,
        first=0,
        robots=WIDTH,
        ticks=round(12.5 / spec.dt),
        sample_ticks=round(12.5 / spec.dt),
    )
    counts = Shard(job).run(lambda _: None, lambda: False).counts
    assert counts.attempted.sum() == 3 * WIDTH
    assert counts.reached.sum() >= 0.9 * counts.attempted.sum()
    assert counts.bad_draws() == 0
