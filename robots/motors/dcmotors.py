"""Attributes of the `dcmotor` elements of a model, by joint."""

from xml.etree import ElementTree

import numpy as np

from robots.errors import RobotError
from robots.models.files import read_xml
from robots.spec import RobotSpec

Attributes = dict[str, str]

DEFAULT_CLASS = "main"
"""Class of elements that name none."""


def dcmotors(spec: RobotSpec) -> dict[str, Attributes]:
    """Return the attributes of each joint's dcmotor, with those of its class and of the classes around that."""
    root = read_xml(spec.model_path)
    classes: dict[str, Attributes] = {DEFAULT_CLASS: {}}
    for top in root.findall("default"):
        _read_class(top, {}, classes)
    found = [
        classes.get(motor.get("class", DEFAULT_CLASS), {}) | motor.attrib
        for motor in root.findall("actuator/dcmotor")
    ]
    return {motor["joint"]: motor for motor in found if "joint" in motor}


def _read_class(element: ElementTree.Element, inherited: Attributes, classes: dict[str, Attributes]) -> None:
    own = inherited.copy()
    for motor in element.findall("dcmotor"):
        own |= motor.attrib
    classes[element.get("class", DEFAULT_CLASS)] = own
    for inner in element.findall("default"):
        _read_class(inner, own, classes)


def numbers(motor: Attributes, key: str, count: int, where: str) -> list[float]:
    """Return the numbers of an attribute; those left out at its end are 0.

    Raises:
        RobotError: it is missing, has more than `count` numbers, or one that is not finite; `where` names the motor.
    """
    try:
        found = [float(word) for word in motor[key].split()]
    except (KeyError, ValueError):
        found = []
    if not 0 < len(found) <= count or not np.isfinite(found).all():
        raise RobotError(f"{where}: {key}: found {motor.get(key)!r}, expected up to {count} numbers")
    return found + [0.0] * (count - len(found))
