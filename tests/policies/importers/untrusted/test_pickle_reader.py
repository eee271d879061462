import pickle

import pytest

from policies.importers.untrusted.pickle_reader import read_pickle
from robots.errors import ContractError


@pytest.mark.parametrize("protocol", [1, 2, 5])
def test_integers_of_torch_are_read(protocol):
    values = [0, -1, 2**64 - 1, -(2**63)]
    assert read_pickle(pickle.dumps(values, protocol), "x.pkl") == values


@pytest.mark.parametrize("value", [2**64, 10**400, -(10**5000)])
def test_longer_integers_are_refused(value):
    with pytest.raises(ContractError) as caught:
        read_pickle(pickle.dumps([value], 2), "x.pkl")
    found = f"x.pkl: found an integer of {value.bit_length()} bits, expected at most 64"
    assert str(caught.value) == f"{found}; nothing of it was run"
