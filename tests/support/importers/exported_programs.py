import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("onnxscript")

from support.importers.torch_files import N, mlp


def saved(folder, module=None, batch=1, observations=N, **how):
    """A file of torch.export.save."""
    path = folder / "policy.pt2"
    program = torch.export.export(module or mlp(), (torch.zeros(batch, observations),), **how)
    torch.export.save(program, path)
    return path
