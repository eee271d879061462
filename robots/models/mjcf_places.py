"""Places that elements of MJCF inherit from default classes, which Pinocchio does not read.

Pinocchio takes size, type and `fromto` of a geom from its default class, but its place from the element alone: a foot
whose class says `pos="0 0 -0.2"` would be at the knee.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import NamedTemporaryFile
from xml.etree.ElementTree import Element, tostring

from robots.models.files import name_files_absolutely

PLACED = ("geom", "site", "joint")
TURNS = ("quat", "axisangle", "euler", "xyaxes", "zaxis")
"""Attributes that turn an element, of which it has one at most."""
MAIN = "main"
"""Name of the class from which all others inherit."""


def inherit_places(root: Element) -> bool:
    """Write inherited places into the elements of a model; return True if there were any.

    Source: MuJoCo XML reference, "default" and "childclass".
    """
    classes = dict(_classes(root))
    inherited = False
    for body in root.findall("worldbody"):
        for element, name in _placed(body, MAIN):
            chain = [own for each in classes.get(name, ()) if (own := each.find(element.tag)) is not None]
            inherited |= _inherit(element, chain)
    return inherited


def _classes(root: Element) -> Iterator[tuple[str, tuple[Element, ...]]]:
    """Yield name and elements of each class, its own first, then those that it inherits from."""
    level: list[tuple[Element, tuple[Element, ...]]] = [(main, ()) for main in root.findall("default")]
    while level:
        default, parents = level.pop()
        chain = (default, *parents)
        yield (default.get("class", "") if parents else MAIN), chain
        level += [(child, chain) for child in default.findall("default")]


def _placed(body: Element, inherited: str) -> Iterator[tuple[Element, str]]:
    """Yield the elements below a body, each with the name of its class."""
    inherited = body.get("childclass", inherited)
    for element in body:
        if element.tag in PLACED:
            yield element, element.get("class", inherited)
        else:
            yield from _placed(element, inherited)


def _inherit(element: Element, chain: list[Element]) -> bool:
    if any("fromto" in each.attrib for each in (element, *chain)):  # it says where the element is
        return False
    places: dict[str, str] = {}
    for names in (("pos",), TURNS):
        if not any(name in element.attrib for name in names):
            places |= next((own for each in chain if (own := _some_of(each, names))), {})
    element.attrib.update(places)
    return bool(places)


def _some_of(element: Element, names: tuple[str, ...]) -> dict[str, str]:
    return {name: element.attrib[name] for name in names if name in element.attrib}


@contextmanager
def temporary_model(root: Element, model: Path, folder: Path) -> Iterator[Path]:
    """Temporary file of the changed root of a model, which finds the robot's meshes from there.

    Raises:
        RobotError: as `referenced_files`.
    """
    name_files_absolutely(root, model, folder)
    with NamedTemporaryFile(suffix=model.suffix) as file:
        file.write(tostring(root))
        file.flush()
        yield Path(file.name)
