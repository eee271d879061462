"""Graphs of other libraries."""

import pytest

from policies.importers.readers import read_policy
from policies.importers.torch_files.network_settings import NetworkSettings
from robots.errors import ContractError


def test_a_graph_is_tried_in_a_separate_process_first(arm_policy, crashing_trial):
    with pytest.raises(ContractError, match=f"^{arm_policy}: {crashing_trial}$"):
        read_policy(arm_policy, NetworkSettings())
