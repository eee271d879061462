"""Mutation of MJCF and URDF: attributes and elements."""

from xml.etree import ElementTree

import numpy as np

VALUES = (
    *(
        "",
        "0",
        "-1",
        "1e308",
        "1e400",
        "nan",
        "inf",
        "9" * 400,
        "2000000000",
        "0 0 0",
        "1 2",
        "1 " * 1000,
        "true",
    ),
    *(
        "world",
        "../../etc/passwd",
        "/dev/zero",
        "package://a/b",
        "\u001b[2J",
        "x" * 10_000,
        "mesh",
        "free",
        "hinge",
    ),
)
"""Values that some attribute does not expect."""
NESTING = (3, 300)
"""Copies of an element that are put inside of one another."""


def mutate_xml(data: bytes, rng: np.random.Generator) -> bytes:
    """Return XML with one to three of its elements changed, removed, copied or nested."""
    root = ElementTree.fromstring(data)
    for _ in range(rng.integers(1, 4)):
        elements = list(root.iter())
        element, other = (elements[rng.integers(len(elements))] for _ in range(2))
        kind, keys = rng.integers(5), [*element.attrib]
        if kind <= 1 and keys:
            key, known = keys[rng.integers(len(keys))], [*other.attrib.values()]
            values = VALUES if rng.integers(2) or not known else known
            element.set(key, values[rng.integers(len(values))])
        elif kind == 2 and keys:
            del element.attrib[keys[rng.integers(len(keys))]]
        elif kind == 3 and len(element):
            element.remove(element[rng.integers(len(element))])
        else:
            _nest(element, other, NESTING[rng.integers(len(NESTING))] if kind == 4 else 1)
    return ElementTree.tostring(root)


def _nest(element: ElementTree.Element, other: ElementTree.Element, depth: int) -> None:
    """Put `depth` empty copies of `other` into each other, and them into `element`."""
    for _ in range(depth):
        element = ElementTree.SubElement(element, other.tag, dict(other.attrib))
