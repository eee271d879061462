"""Policy file of unknown origin, whose step is tried in a separate process before it is loaded in this one."""

from pathlib import Path

from deploy.policy.policy_file import PolicyFile, read_policy_file
from deploy.policy.step_trial import try_step


def read_tried_policy(path: Path) -> PolicyFile:
    """Read a policy file, check all of it, and try its step and its golden pairs.

    Raises:
        ContractError: as `read_policy_file` and `try_step`.
    """
    file = read_policy_file(path)
    try_step(file.data, str(path), golden=True)
    return file
