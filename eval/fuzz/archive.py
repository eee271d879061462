"""Mutation of archives of torch, numpy and Stable-Baselines3: their members."""

import io
import re
import zipfile

import numpy as np

from eval.fuzz.plain_bytes import mutate_bytes
from eval.fuzz.text import mutate_text

COMPRESSIONS = (zipfile.ZIP_STORED, zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2)
BOMB = bytes(1 << 20)
WEIGHTS = re.compile(r"/\w*\d$")
"""Members of plain numbers, which say the least to a reader: only whole ones are exchanged."""


def mutate_archive(data: bytes, rng: np.random.Generator) -> bytes:
    """Return an archive with one member changed, removed, renamed, repeated or blown up."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = [(record.filename, archive.read(record)) for record in archive.infolist()]
    places = [k for k, (name, _) in enumerate(members) if not WEIGHTS.search(name)]
    place, other = places[rng.integers(len(places))], int(rng.integers(len(members)))
    name, content = members[place]
    kind = rng.integers(8)
    if kind <= 3:
        members[place] = name, _mutate_member(content, rng)
    elif kind == 4:
        del members[place]
    elif kind == 5:
        members[place] = members[other][0], content
    elif kind == 6:
        members[place] = name, members[other][1]
    else:
        members[place] = name, content + BOMB
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", COMPRESSIONS[rng.integers(len(COMPRESSIONS))]) as archive:
        for number, (name, content) in enumerate(dict(members).items()):
            archive.writestr(zipfile.ZipInfo(name if number < len(members) else f"{name}x"), content)
    return stream.getvalue()


def _mutate_member(content: bytes, rng: np.random.Generator) -> bytes:
    """Mutate text as text, and anything else as bytes."""
    try:
        content.decode()
    except UnicodeDecodeError:
        return mutate_bytes(content, rng)
    return mutate_text(content, rng)
