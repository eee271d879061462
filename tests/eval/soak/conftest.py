from types import SimpleNamespace

import pytest
from rich.console import Console

from deploy.policy.policy import Policy
from eval.statistics.budget import BUDGET
from support.arm6 import SPEC
from support.policies import policy_model, saved


@pytest.fixture(scope="session")
def finished(tmp_path_factory):
    """A soak of 4.7 s of two shards, the second not full, of a policy that throws the arms about.

    `soak`; `kept`, the folder of its checkpoints and bundles; `shards`, its results. Nobody may change them.
    """
    from eval.shard.job import WIDTH
    from eval.soak.configuration import SoakConfig
    from eval.soak.workers import run_soak

    folder = tmp_path_factory.mktemp("finished")
    path = saved(policy_model(), folder)
    options = {"budget": BUDGET, "hours": 0.0013, "robots": WIDTH + 2, "seed": 3, "workers": 1}
    soak = SoakConfig(spec=SPEC, policy=Policy.load(path, SPEC), policy_path=path, **options)
    shards = run_soak(soak, folder / "unfinished", Console(quiet=True))
    return SimpleNamespace(soak=soak, kept=folder / "unfinished", shards=shards)
