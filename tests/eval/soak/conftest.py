from types import SimpleNamespace

import pytest
from rich.console import Console

from support.arm6 import SPEC
from support.policies import policy_model, saved
from support.shared import made_once


@pytest.fixture(scope="session")
def finished(tmp_path_factory):
    """A soak of 4.7 s of two shards, the second not full, of a policy that throws the arms about.

    `soak`; `kept`, the folder of its checkpoints and bundles; `shards`, its results. Nobody may change them.
    """
    from eval.shard.job import WIDTH
    from eval.shard.judging import shard_result
    from eval.soak.workers import run_soak
    from support.eval.soaks import soak_config

    def config(folder):
        return soak_config(folder / "policy.onnx", hours=0.0013, robots=WIDTH + 2)

    def make(folder):
        saved(policy_model(), folder)
        run_soak(config(folder), folder / "unfinished", Console(quiet=True))

    folder = made_once(tmp_path_factory, "finished", make)
    soak, kept = config(folder), folder / "unfinished"
    shards = [
        shard_result(SPEC, soak.policy.contract, job.robots, soak.checkpoint(number, kept).load())
        for number, job in enumerate(soak.jobs())
    ]
    return SimpleNamespace(soak=soak, kept=kept, shards=shards)
