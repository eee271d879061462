import sys
from functools import cache

import pytest


@pytest.fixture(scope="session", autouse=True)
def _operators_listed_once():
    """The exporter of torch asks onnxscript for all its operators with every export: half of an export's time."""
    if "onnxscript" not in sys.modules:
        yield
        return
    operators = "torch.onnx._internal._lazy_import.onnxscript_apis.get_torchlib_ops"
    with pytest.MonkeyPatch.context() as patch:
        from torch.onnx._internal import _lazy_import

        patch.setattr(operators, cache(_lazy_import.onnxscript_apis.get_torchlib_ops))
        yield
