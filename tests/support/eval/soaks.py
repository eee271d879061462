from deploy.policy.policy import Policy
from eval.soak.configuration import SoakConfig
from eval.statistics.budget import BUDGET
from support.arm6 import SPEC


def soak_config(path, spec=SPEC, **options):
    """A soak of the policy in a file, of seed 3 with one worker."""
    options = {"budget": BUDGET, "seed": 3, "workers": 1} | options
    return SoakConfig(spec=spec, policy=Policy.load(path, spec), policy_path=path, **options)
