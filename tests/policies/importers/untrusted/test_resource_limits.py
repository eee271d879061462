"""Memory of an import: too much for any computer, or for this one."""

import resource
from pathlib import Path

import pytest

from policies.importers.untrusted.resource_limits import limit_memory
from robots.errors import ContractError


def fill():
    with limit_memory(Path("policy.pt")):
        raise MemoryError


@pytest.mark.parametrize("kind", [resource.RLIMIT_DATA, resource.RLIMIT_AS])
@pytest.mark.parametrize(("allowed_gib", "error"), [(7, MemoryError), (9, ContractError)])
def test_only_a_limit_of_the_import_is_one_of_the_policy(monkeypatch, kind, allowed_gib, error):
    none = (resource.RLIM_INFINITY, resource.RLIM_INFINITY)
    found = {kind: (allowed_gib << 30, resource.RLIM_INFINITY)}
    monkeypatch.setattr(resource, "getrlimit", lambda kind: found.get(kind, none))
    monkeypatch.setattr(resource, "setrlimit", lambda *_: None)
    with pytest.raises(error):
        fill()
