"""Generated robot.toml, draws.toml and limits.toml: values of the model, estimates marked as such, and "?"."""

import tomllib
from collections.abc import Mapping
from typing import Any

import tomlkit
from tomlkit.items import AoT, Table

from policies.robot_init import legged_defaults
from policies.robot_init.vendor_model import VendorJoint, VendorModel
from robots.spec import ROBOTS
from robots.strict import PLACEHOLDER

EXAMPLE = ROBOTS / "arm6"
"""Robot whose values are used as estimates."""
RANGE_MARGIN = 0.02
"""Margin of working limits at each end, as a share of the joint's range; legs use the whole range."""
SENSORS = ("encoder", "current", "temperature")
ESTIMATE = "estimate, replace by the data sheet"

HEAD = """{name}: values of the model are filled in. Replace every "?" and check every estimate.
SI units unless a key ends in a unit. Keys are explained in robots/spec.py, tables.py and drive.py."""
MOTOR = {
    "housing_resistance_k_per_w": "K/W, housing to ambient",
    "housing_capacity_j_per_k": "J/K",
    "iron_w_s2": "W/(rad/s)² at the motor's shaft, eddy currents",
    "winding_soft_c": "°C, above which current is reduced",
    "winding_max_c": "°C, above which it is damaged",
    "housing_soft_c": "°C",
    "housing_max_c": "°C",
    "source": "source of the numbers",
}
DRIVE = {
    "gear": "motor turns per joint turn",
    "torque_constant": "N·m/A of the motor, without gear",
    "resistance_ohm": "ohm, of the winding at reference_c",
    "reference_c": "°C",
    "copper_per_k": "1/K, copper",
    "winding_resistance_k_per_w": "K/W, winding to housing",
    "winding_capacity_j_per_k": "J/K, time constant divided by winding_resistance_k_per_w",
    "supply_v": "V",
    "kp": "N·m/rad at the joint",
    "kd": "N·m·s/rad at the joint",
    "torque_max": "N·m at the joint",
    "armature": "kg·m², rotor inertia times gear²",
}
JOINT = {
    "q_min": "rad",
    "q_max": "rad",
    "q_home": "rad, rest and start position",
    "qd_max": "rad/s, limit of the drive",
    "qdd_max": "rad/s², limit of commanded motion",
    "qddd_max": "rad/s³, limit of commanded motion",
    "acceleration_density": "rad²/s³, estimate: see robots/tables.py",
    "play": "rad, estimate",
}
DRIVE_DEFAULTS = {"reference_c": 25.0, "copper_per_k": 0.0039}


def robot_toml(
    vendor: VendorModel, name: str, model: str, neighbours: tuple[tuple[str, str], ...]
) -> tomlkit.TOMLDocument:
    """Return robot.toml."""
    document = _commented(HEAD.format(name=name))
    example = tomllib.loads((EXAMPLE / "robot.toml").read_text(encoding="utf-8"))
    document |= {"name": name, "model": model}
    if not vendor.floating_base:
        known = ", ".join((*vendor.sites, *vendor.bodies))
        document.add("tool", _value(vendor.tool, f"a site or a body: {known}"))
    if vendor.locked:
        document.add(
            "locked",
            _value(list(vendor.locked), "prismatic joints, and joints without actuator in the model"),
        )
    if neighbours:
        near = _value([list(pair) for pair in neighbours], "excluded by the model, or touching in every pose")
        document.add("neighbours", near)
    document.add("rates", tomlkit.item(legged_defaults.RATES if vendor.floating_base else example["rates"]))
    document.add("margins", _margins(vendor, example["margins"]))
    if vendor.floating_base:
        document.add(
            "base", _table(legged_defaults.base_values(vendor), legged_defaults.base_descriptions(vendor))
        )
    else:
        document.add("workspace", _workspace(vendor, example["workspace"]))
    document.add("sensors", _sensors(vendor, example["sensors"]))
    motors = _motors(vendor)
    document.add("motors", _motor_tables(vendor, motors))
    document.add("joints", _joints(vendor, motors))
    if vendor.shapes and not vendor.plain:
        document.add("capsules", _capsules(vendor))
    return document


def draws_toml(vendor: VendorModel) -> tomlkit.TOMLDocument:
    """Return the example's draws.toml, with the cable on a link of this robot."""
    document = tomlkit.parse((EXAMPLE / "draws.toml").read_text(encoding="utf-8"))
    bodies = [joint.body for joint in vendor.joints if joint.name not in vendor.locked]
    cable = document["cable"]
    cable["link"] = bodies[len(bodies) // 2] if bodies else PLACEHOLDER
    cable["above_m"] = round(vendor.centre[2] + 1.2 * vendor.reach, 2)
    if vendor.floating_base:  # it walks away from the cable's suspension
        cable["stiffness_n_per_m"].update({"low": 0.0, "high": 0.0, "log": False})
    return document


def limits_toml(vendor: VendorModel, name: str) -> tomlkit.TOMLDocument:
    """Return limits.toml; values that depend on the robot's size are open."""
    document = _commented(
        f"Limits of {name} checked by the judge of a soak, besides robot.toml; explained in eval/judge/limits.py."
    )
    example = tomllib.loads((EXAMPLE / "limits.toml").read_text(encoding="utf-8"))
    left_out = {"motors", "manipulability"} if vendor.floating_base else {"motors"}
    descriptions = {"power_w": PLACEHOLDER} | (
        legged_defaults.LIMITS | {"contact_n": PLACEHOLDER} if vendor.floating_base else {}
    )
    document |= {key: value for key, value in example.items() if key not in left_out} | descriptions
    motors = {
        motor: {"power_w": PLACEHOLDER, "torque_rate": PLACEHOLDER, "source": PLACEHOLDER}
        for motor in set(_motors(vendor).values())
    }
    document.add("motors", tomlkit.item(dict(sorted(motors.items()))))
    return document


def _commented(text: str) -> tomlkit.TOMLDocument:
    document = tomlkit.document()
    for line in text.splitlines():
        document.add(tomlkit.comment(line))
    return document


def _value(value: Any, meaning: str) -> Any:
    """Return a value, or "?" for None, with its description as a comment."""
    item = tomlkit.item(PLACEHOLDER if value is None else value)
    return item.comment(meaning)


def _table(values: Mapping[str, Any], descriptions: Mapping[str, str]) -> Table:
    table = tomlkit.table()
    for key, meaning in descriptions.items():
        table.add(key, _value(values.get(key), meaning))
    return table


def _workspace(vendor: VendorModel, example: Mapping[str, Any]) -> Table:
    table = tomlkit.table()
    table.add("z_min", _value(0.03, "m; estimate: above a table at z = 0"))
    table.add("radius_max", _value(vendor.reach or None, "m; arm stretched to its last body"))
    table.add("centre", _value(list(vendor.centre), "m, of the first joint"))
    table.add("tool_speed_max", _value(example["tool_speed_max"], "m/s; estimate"))
    return table


def _margins(vendor: VendorModel, example: Mapping[str, Any]) -> Table:
    legged = legged_defaults.MARGINS if vendor.floating_base else {}
    left_out = legged_defaults.ARM_MARGINS if vendor.floating_base else ()
    margins = {key: value for key, value in {**example, **legged}.items() if key not in left_out}
    table = tomlkit.table()
    table.update(margins)
    table.comment("estimates, most of them as arm6")
    return table


def _sensors(vendor: VendorModel, example: Mapping[str, Any]) -> Any:
    found = {kind: example[kind] for kind in SENSORS}
    found = (
        legged_defaults.sensors(vendor, found) if vendor.floating_base else {**found, "goal": example["goal"]}
    )
    return tomlkit.item({kind: {**sensor, "source": ESTIMATE} for kind, sensor in found.items()})


def _motors(vendor: VendorModel) -> dict[str, str]:
    """Return the motor name of each driven joint; joints with the same properties share a motor."""
    kinds: dict[tuple[Any, ...], str] = {}
    found = {}
    for joint in _driven(vendor):
        properties = (joint.torque_range, joint.torque_max, joint.kp, joint.kd, joint.gear, joint.armature)
        found[joint.name] = kinds.setdefault(properties, f"motor{len(kinds) + 1}")
    return found


def _driven(vendor: VendorModel) -> list[VendorJoint]:
    return [joint for joint in vendor.joints if joint.name not in vendor.locked]


def _motor_tables(vendor: VendorModel, motors: Mapping[str, str]) -> Table:
    table = tomlkit.table(is_super_table=True)
    for joint in _driven(vendor):
        name = motors[joint.name]
        if name in table:
            continue
        motor = _table({}, MOTOR)
        if not vendor.drives:
            known = {"gear": joint.gear, "kp": joint.kp, "kd": joint.kd, "torque_max": joint.torque_max}
            given = {"torque_max": joint.torque_range is not None, "armature": joint.armature > 0}
            descriptions = {key: meaning for key, meaning in DRIVE.items() if not given.get(key)}
            motor.add("drive", _table(DRIVE_DEFAULTS | known, descriptions))
        table.add(name, motor)
    return table


def _joints(vendor: VendorModel, motors: Mapping[str, str]) -> AoT:
    tables = tomlkit.aot()
    estimates = {
        "acceleration_density": legged_defaults.ACCELERATION_DENSITY if vendor.floating_base else 0.02,
        "play": 0.0005,
    }
    for joint in _driven(vendor):
        low, high = (joint.low, joint.high) if vendor.floating_base else _working_range(joint)
        known = {"q_min": low, "q_max": high, "q_home": joint.home, "qd_max": joint.qd_max}
        table = tomlkit.table()
        table.add("name", joint.name)
        for key, item in _table(known | estimates, JOINT).items():
            table.add(key, item)
        table.add("motor", motors[joint.name])
        table.add("source", PLACEHOLDER)
        tables.append(table)
    return tables


def _working_range(joint: VendorJoint) -> tuple[float | None, float | None]:
    """Return working limits in rad, inside the mechanical limits by `RANGE_MARGIN`."""
    if joint.low is None or joint.high is None:
        return None, None
    margin = RANGE_MARGIN * (joint.high - joint.low)
    return round(joint.low + margin, 4), round(joint.high - margin, 4)


def _capsules(vendor: VendorModel) -> AoT:
    tables = tomlkit.aot()
    for shape in vendor.shapes:
        table = tomlkit.table()
        table |= {
            "body": shape.body,
            "start": list(shape.start),
            "end": list(shape.end),
            "radius": shape.radius,
        }
        tables.append(table)
    return tables
