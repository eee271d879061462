import pickle

import pytest

from policies.importers.untrusted.pickle_reader import read_pickle
from robots.errors import ContractError


@pytest.mark.parametrize("protocol", [1, 2, 5])
def test_integers_of_generators_are_read(protocol):
    values = [0, -1, 2**128 - 1, -(2**127)]
    assert read_pickle(pickle.dumps(values, protocol), "x.pkl") == values


@pytest.mark.parametrize(("sign", "bits"), [(1, 129), (1, 1330), (-1, 16610)])
def test_longer_integers_are_refused(sign, bits):
    with pytest.raises(ContractError) as caught:
        read_pickle(pickle.dumps([sign << (bits - 1)], 2), "x.pkl")
    found = f"x.pkl: found an integer of {bits} bits, expected at most 128"
    assert str(caught.value) == f"{found}; nothing of it was run"
