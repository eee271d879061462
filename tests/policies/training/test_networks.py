import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("rsl_rl")

from rsl_rl.models import MLPModel
from tensordict import TensorDict

from policies.training.networks import Actor
from robots.errors import ContractError

pytestmark = pytest.mark.slow

GAUSSIAN = {
    "class_name": "rsl_rl.modules.distribution:GaussianDistribution",
    "init_std": 0.6,
    "std_type": "log",
}


def rsl_rl_model(seed=0, *, normalized=True, kind=MLPModel, **changes):
    """A model of the learner whose statistics come from its own updates, on skewed and shifted data."""
    torch.manual_seed(seed)
    settings = {"hidden_dims": (32, 16), "activation": "elu", "distribution_cfg": dict(GAUSSIAN)}
    groups = {"joints": torch.zeros(1, 15), "goal": torch.zeros(1, 9)}
    model = kind(
        TensorDict(groups, batch_size=[1]),
        {"actor": ["joints", "goal"]},
        "actor",
        6,
        obs_normalization=normalized,
        **{**settings, **changes},
    )
    for _ in range(3 if normalized else 0):
        model.update_normalization(observations(500))
    return model


def observations(count):
    raw = torch.randn(count, 24) ** 2 * torch.logspace(-3, 2, 24) + torch.linspace(-5, 5, 24)
    return TensorDict({"joints": raw[:, :15], "goal": raw[:, 15:]}, batch_size=[count])


def flat(batch):
    return torch.cat([batch["joints"], batch["goal"]], dim=-1)


@pytest.mark.parametrize("normalized", [True, False])
@pytest.mark.parametrize("hidden", [(32, 16), (8,), (16, 16, 16)])
def test_export_view_equals_the_learner(normalized, hidden):
    model = rsl_rl_model(normalized=normalized, hidden_dims=hidden)
    actor = Actor.from_rsl_rl(model)
    assert actor.layers == hidden
    batch = observations(2000)
    with torch.no_grad():
        assert torch.equal(actor(flat(batch)), model(batch))
        assert torch.equal(actor(flat(batch)), model.as_onnx(verbose=False)(flat(batch)))


def test_the_mean_is_exported_not_a_sample():
    model = rsl_rl_model()
    batch = observations(100)
    with torch.no_grad():
        model(batch, stochastic_output=True)
        assert torch.equal(Actor.from_rsl_rl(model)(flat(batch)), model.output_mean)


def test_the_normalizer_matters():
    model = rsl_rl_model()
    batch = flat(observations(1000))
    actor = Actor.from_rsl_rl(model)
    assert (actor.mean.abs() > 0.1).any()
    assert actor.divisor.max() / actor.divisor.min() > 100
    with torch.no_grad():
        assert (actor(batch) - model.mlp(batch)).abs().max() > 0.1


def test_export_view_is_a_copy():
    model = rsl_rl_model()
    actor = Actor.from_rsl_rl(model)
    batch = flat(observations(10))
    before = actor(batch)
    model.update_normalization(observations(5000))
    with torch.no_grad():
        for weight in model.mlp.parameters():
            weight.zero_()
    assert torch.equal(actor(batch), before)
    assert not any(weight.requires_grad for weight in actor.parameters())


class Doubled(MLPModel):
    def forward(self, *args, **kwargs):
        return 2 * super().forward(*args, **kwargs)


OTHER = "rsl_rl.modules.distribution:"
INEXPRESSIBLE = {
    "activation": (
        {"activation": "relu"},
        "found layers Linear, ReLU, Linear, ReLU, Linear, expected Linear, ELU",
    ),
    "subclass": ({"kind": Doubled}, "found Doubled, expected MLPModel"),
    "beta": (
        {"distribution_cfg": {"class_name": f"{OTHER}BetaDistribution"}},
        "found distribution BetaDistribution",
    ),
    "variance": (
        {"distribution_cfg": {"class_name": f"{OTHER}HeteroscedasticGaussianDistribution"}},
        "found distribution HeteroscedasticGaussianDistribution, expected GaussianDistribution",
    ),
}


@pytest.mark.parametrize(("changes", "message"), INEXPRESSIBLE.values(), ids=INEXPRESSIBLE)
def test_networks_that_cannot_be_exported_are_refused(changes, message):
    with pytest.raises(ContractError) as caught:
        Actor.from_rsl_rl(rsl_rl_model(**changes))
    assert str(caught.value).startswith(f"rsl_rl actor: {message}")
