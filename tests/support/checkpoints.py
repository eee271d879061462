import pytest

torch = pytest.importorskip("torch")

from policies.training.checkpoint import save_checkpoint
from policies.training.networks import Actor
from support.contracts import arm_contract

LAYERS = (32, 16)


def made_actor(seed=0):
    """An untrained actor with a normalizer that matters."""
    torch.manual_seed(seed)
    actor = Actor(30, 6, LAYERS)
    actor.mean.normal_()
    actor.divisor.uniform_(0.1, 3.0)
    return actor


def saved(folder, *, actor=None, contract=None, spread=1.0, name="arm.pt"):
    """A checkpoint file with a made-up rollout."""
    actor = actor or made_actor()
    rollout = torch.randn(1100, 30, generator=torch.Generator().manual_seed(9))
    rollout[5] *= spread
    path = folder / name
    save_checkpoint(path, actor, contract or arm_contract(), rollout, seed=3, recipe="steps = 1\n")
    return path
