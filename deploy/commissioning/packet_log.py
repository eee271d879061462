"""Log of raw packets and of what was sent, tick by tick, for robot 0."""

import numpy as np
from numpy.typing import NDArray

from deploy.runtime import Runtime
from robots.arrays import Floats, Ints

COLUMNS = ("t", "mode", "encoder_t", "encoder", "current_t", "current", "q_sent", "qd_sent", "q_hat")


class PacketLog:
    """Rows of a run, one for each tick.

    Columns: `t` s, `mode` of the supervisor, the newest packets and their times (`encoder` rad, `current` A, with
    `_t` s), the setpoint sent in that tick (`q_sent` rad, `qd_sent` rad/s), which drives reach one period later, and
    the estimate (`q_hat` rad).
    """

    def __init__(self) -> None:
        self._rows: dict[str, list[object]] = {name: [] for name in COLUMNS}

    def __len__(self) -> int:
        return len(self._rows["t"])

    def add(self, runtime: Runtime) -> None:
        """Copy the tick that has just ended."""
        encoder, current = runtime.sample["encoder"], runtime.sample["current"]
        sent, state = runtime.setpoint, runtime.state
        mode = int(runtime.supervisor.mode[0])
        packets = (encoder.t[0], encoder.value[0].copy(), current.t[0], current.value[0].copy())
        values = (state.t, mode, *packets, sent.q[0].copy(), sent.qd[0].copy(), state.q[0].copy())
        for column, value in zip(self._rows.values(), values, strict=True):
            column.append(value)

    def column(self, name: str, begin: int = 0, end: int | None = None) -> Floats:
        """Return (T,) or (T, n) of the rows from `begin` to before `end`."""
        return np.array(self._rows[name][begin:end], dtype=np.float64)

    def packets(self, kind: str, begin: int = 0, end: int | None = None) -> tuple[Ints, Floats, Floats]:
        """Return each packet of a kind once: its row, (P,), its time, (P,) s, and its values, (P, n).

        Packets with a channel without reading are left out.
        """
        t, value = self.column(f"{kind}_t", begin, end), self.column(kind, begin, end)
        newest = np.maximum.accumulate(t)
        new: NDArray[np.bool_] = np.concatenate(([True], t[1:] > newest[:-1])) & np.isfinite(value).all(
            axis=1
        )
        rows = np.flatnonzero(new)
        return rows + begin, t[rows], value[rows]
