import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("onnxscript")

import warnings
import zipfile

from torch import nn

N, A, HIDDEN = 7, 3, 8


class Recurrent(nn.Module):
    """As Unitree and rsl_rl export theirs."""

    def __init__(self, observations=N, actions=A):
        super().__init__()
        self.actor = nn.Sequential(
            nn.Linear(HIDDEN, 6), nn.ELU(), nn.Linear(6, actions)
        )  # before what it is asked with
        self.rnn = nn.LSTM(observations, HIDDEN)
        self.register_buffer("hidden_state", torch.zeros(1, 1, HIDDEN))
        self.register_buffer("cell_state", torch.zeros(1, 1, HIDDEN))

    def forward(self, x):
        out, (h, c) = self.rnn(x.unsqueeze(0), (self.hidden_state, self.cell_state))
        self.hidden_state[:] = h
        self.cell_state[:] = c
        return self.actor(out.squeeze(0))


def mlp():
    torch.manual_seed(0)
    return nn.Sequential(nn.Linear(N, 16), nn.ELU(), nn.Linear(16, A)).eval()


def saved_script(path, module, make=None):
    """A file of torch.jit.save."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        make = make or torch.jit.script
        torch.jit.save(make(module), path)
    return path


def members(path):
    with zipfile.ZipFile(path) as archive:
        return {record.filename: archive.read(record) for record in archive.infolist()}


def changed(path, name, change):
    """The same archive but for one of its members."""
    found = members(path)
    (full,) = (key for key in found if key.partition("/")[2] == name)
    found[full] = change(found[full])
    with zipfile.ZipFile(path, "w") as archive:
        for key, data in found.items():
            archive.writestr(key, data)
    return path
