"""Mutation of a file of any format: its bytes."""

import numpy as np

RUN_MAX = 64
"""Bytes that one change covers."""
FILLINGS = (b"\x00", b"\xff", b"\x7f", b"\x80", b"(", b"[", b"9", b"PK\x01\x02", b"\x80\x02", b"R", b"0" * 16)
"""Bytes that mean something in a format: ends, signs, opcodes of pickles, records of archives."""


def mutate_bytes(data: bytes, rng: np.random.Generator) -> bytes:
    """Return bytes with one to four runs changed, cut, repeated, moved or filled."""
    found = bytearray(data)
    for _ in range(rng.integers(1, 5)):
        start, other = (int(rng.integers(0, len(found) + 1)) for _ in range(2))
        length = int(rng.integers(1, RUN_MAX))
        run, filling = found[start : start + length], FILLINGS[rng.integers(len(FILLINGS))]
        kind = rng.integers(6)
        if kind == 0 and run:
            found[start] ^= 1 << int(rng.integers(8))
        elif kind == 1:
            found[start : start + length] = filling * (length // len(filling) + 1)
        elif kind == 2:
            del found[start : start + length]
        elif kind == 3:
            found[other:other] = run
        elif kind == 4:
            found[start:start] = rng.bytes(length)
        else:
            del found[start:]
    return bytes(found)
