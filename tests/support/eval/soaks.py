from deploy.policy.policy import Policy
from eval.shard.shard import Shard
from eval.soak.checkpoint import prepare_folder
from eval.soak.configuration import SoakConfig
from eval.statistics.budget import BUDGET
from support.arm6 import SPEC


def soak_config(path, spec=SPEC, **options):
    """A soak of the policy in a file, of seed 3 with one worker."""
    options = {"budget": BUDGET, "seed": 3, "workers": 1} | options
    return SoakConfig(spec=spec, policy=Policy.load(path, spec), policy_path=path, **options)


def store_ticks(soak, number, folder, ticks):
    """Store a checkpoint of shard `number`, as if its robots had stood still for so many ticks, and return it."""
    prepare_folder(folder)
    checkpoint, shard = soak.checkpoint(number, folder), Shard(soak.jobs()[number])
    shard.runtime.ticks = ticks
    for _ in range(ticks // soak.sample_ticks + 1):
        shard.sample()
    checkpoint.store(shard.save())
    return checkpoint
