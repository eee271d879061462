"""Mutation of a file by its format, which its suffix names."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from eval.fuzz.archive import mutate_archive
from eval.fuzz.onnx_model import mutate_onnx
from eval.fuzz.plain_bytes import mutate_bytes
from eval.fuzz.text import mutate_text
from eval.fuzz.xml_tree import mutate_xml

Mutate = Callable[[bytes, np.random.Generator], bytes]
FORMATS: dict[str, Mutate] = {
    **dict.fromkeys((".json", ".toml", ".yaml"), mutate_text),
    **dict.fromkeys((".xml", ".urdf"), mutate_xml),
    **dict.fromkeys((".npz", ".pt", ".pt2", ".zip"), mutate_archive),
    ".onnx": mutate_onnx,
}
BYTES_SHARE = 0.3
"""Part of the cases in which only bytes are changed, whatever the format."""


def mutate_file(path: Path, rng: np.random.Generator) -> None:
    """Replace a valid file by a mutation of it."""
    change = FORMATS.get(path.suffix, mutate_bytes)
    data = path.read_bytes()
    path.write_bytes((mutate_bytes if rng.random() < BYTES_SHARE else change)(data, rng))
