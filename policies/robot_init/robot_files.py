"""Generated robot.toml, draws.toml and limits.toml: values of the model, estimates marked as such, and "?"."""

import tomllib
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import tomlkit
from tomlkit.items import AoT, Table

from policies.robot_init import legged_defaults
from policies.robot_init.vendor_model import Actuator, VendorJoint, VendorModel
from policies.toml_draft import commented_document, fill
from robots.spec import ROBOTS
from robots.strict import PLACEHOLDER

EXAMPLE = ROBOTS / "arm6"
"""Robot whose values are used as estimates."""
RANGE_MARGIN = 0.02
"""Margin of working limits at each end, as a share of the joint's range; legs use the whole range."""
SENSORS = ("encoder", "current", "temperature")
ESTIMATE = "estimate, replace by the data sheet"

HEAD = """{name}: values of the model are filled in. Replace every "?" and check every estimate.
SI units unless a key ends in a unit. Keys are explained in robots/robot_file.py, margins.py,
tables.py and sensors.py."""
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
    "q_min": "rad; leave out both of a joint without ends",
    "q_max": "rad",
    "q_home": "rad, rest and start position",
    "qd_max": "rad/s, limit of the drive",
    "qdd_max": "rad/s², limit of commanded motion",
    "qddd_max": "rad/s³, limit of commanded motion",
    "acceleration_density": "rad²/s³, estimate: see robots/tables.py",
    "play": "rad, estimate",
}
LISTS = {
    "locked": "prismatic joints, and joints without actuator in the model",
    "neighbours": "excluded by the model, or touching in every pose",
}
WORKSPACE = {
    "z_min": "m; estimate: above a table at z = 0",
    "radius_max": "m; arm stretched to its last body",
    "centre": "m, of the first joint",
    "tool_speed_max": "m/s; estimate",
}
LIMITS_HEAD = (
    "Limits of {name} checked by the judge of a soak, besides robot.toml; explained in eval/judge/limits.py."
)
DRIVE_DEFAULTS = {"reference_c": 25.0, "copper_per_k": 0.0039}


def robot_toml(
    vendor: VendorModel, name: str, model: str, neighbours: tuple[tuple[str, str], ...]
) -> tomlkit.TOMLDocument:
    """Return robot.toml."""
    example = tomllib.loads((EXAMPLE / "robot.toml").read_text(encoding="utf-8"))
    document = fill(commented_document(HEAD.format(name=name)), {"name": name, "model": model}, {})
    if not vendor.floating_base:
        known = ", ".join((*vendor.sites, *vendor.bodies))
        fill(document, {"tool": vendor.tool}, {"tool": f"a site or a body: {known}"})
    lists = {"locked": list(vendor.locked), "neighbours": [list(pair) for pair in neighbours]}
    for key, entries in lists.items():
        if entries:
            fill(document, {key: entries}, {key: LISTS[key]})
    document |= _tables(vendor, example)
    return document


def _tables(vendor: VendorModel, example: Mapping[str, Any]) -> dict[str, Any]:
    """Return the tables of robot.toml in their order."""
    legged, motors = vendor.floating_base, _motors(vendor)
    return {
        "rates": tomlkit.item(legged_defaults.RATES if legged else example["rates"]),
        "margins": _margins(vendor, example["margins"]),
        **({"base": _base(vendor)} if legged else {"workspace": _workspace(vendor, example["workspace"])}),
        "sensors": _sensors(vendor, example["sensors"]),
        "motors": _motor_tables(vendor, motors),
        "joints": _joints(vendor, motors),
        **({"capsules": _capsules(vendor)} if vendor.shapes and not vendor.plain else {}),
    }


def _base(vendor: VendorModel) -> Table:
    known, descriptions = legged_defaults.base_values(vendor), legged_defaults.base_descriptions(vendor)
    return fill(tomlkit.table(), known, descriptions)


def draws_toml(vendor: VendorModel) -> tomlkit.TOMLDocument:
    """Return the example's draws.toml, with the cable on a link of this robot."""
    document = tomlkit.parse((EXAMPLE / "draws.toml").read_text(encoding="utf-8"))
    bodies = [joint.body for joint in vendor.driven]
    cable = document["cable"]
    cable["link"] = bodies[len(bodies) // 2] if bodies else PLACEHOLDER
    cable["above_m"] = round(vendor.centre[2] + 1.2 * vendor.reach, 2)
    if vendor.floating_base:  # it walks away from the cable's suspension
        cable["stiffness_n_per_m"].update({"low": 0.0, "high": 0.0, "log": False})
    return document


def limits_toml(vendor: VendorModel, name: str) -> tomlkit.TOMLDocument:
    """Return limits.toml; values that depend on the robot's size are open."""
    limits = tomllib.loads((EXAMPLE / "limits.toml").read_text(encoding="utf-8"))
    del limits["motors"]
    limits["power_w"] = PLACEHOLDER
    if vendor.floating_base:
        del limits["manipulability"]
        limits |= legged_defaults.LIMITS | {"contact_n": PLACEHOLDER}
    document = commented_document(LIMITS_HEAD.format(name=name))
    document |= limits
    motor = dict.fromkeys(("power_w", "torque_rate", "source"), PLACEHOLDER)
    document.add("motors", tomlkit.item(dict.fromkeys(sorted(set(_motors(vendor).values())), motor)))
    return document


def _workspace(vendor: VendorModel, example: Mapping[str, Any]) -> Table:
    known = {"z_min": 0.03, "radius_max": vendor.reach or None, "centre": list(vendor.centre)}
    return fill(tomlkit.table(), known | {"tool_speed_max": example["tool_speed_max"]}, WORKSPACE)


def _margins(vendor: VendorModel, example: Mapping[str, Any]) -> Table:
    legged = legged_defaults.MARGINS if vendor.floating_base else {}
    left_out = legged_defaults.ARM_MARGINS if vendor.floating_base else ()
    margins = {key: value for key, value in {**example, **legged}.items() if key not in left_out}
    table = tomlkit.table()
    table.update(margins)
    table.comment(legged_defaults.MARGINS_COMMENT if legged else "estimates, most of them as arm6")
    return table


def _sensors(vendor: VendorModel, example: Mapping[str, Any]) -> Any:
    found = {kind: example[kind] for kind in SENSORS}
    legged = vendor.floating_base
    found = legged_defaults.sensors(vendor, found) if legged else {**found, "goal": example["goal"]}
    return tomlkit.item({kind: {**sensor, "source": ESTIMATE} for kind, sensor in found.items()})


def _motors(vendor: VendorModel) -> dict[str, str]:
    """Return the motor name of each driven joint; joints with the same properties share a motor."""
    kinds: dict[tuple[Any, ...], str] = {}
    found = {}
    for joint in vendor.driven:
        properties = (joint.torque_range, joint.actuator or Actuator(), joint.armature)
        found[joint.name] = kinds.setdefault(properties, f"motor{len(kinds) + 1}")
    return found


def _motor_tables(vendor: VendorModel, motors: Mapping[str, str]) -> Table:
    table = tomlkit.table(is_super_table=True)
    for joint in vendor.driven:
        name, known = motors[joint.name], asdict(joint.actuator or Actuator())
        if name in table:
            continue
        motor = fill(tomlkit.table(), {}, MOTOR)
        if not vendor.drives:
            in_model = {"torque_max": joint.torque_range is not None, "armature": joint.armature > 0}
            descriptions = {key: meaning for key, meaning in DRIVE.items() if not in_model.get(key)}
            motor.add("drive", fill(tomlkit.table(), DRIVE_DEFAULTS | known, descriptions))
        table.add(name, motor)
    return table


def _joints(vendor: VendorModel, motors: Mapping[str, str]) -> AoT:
    tables, legged = tomlkit.aot(), vendor.floating_base
    density = legged_defaults.ACCELERATION_DENSITY if legged else 0.02
    for joint in vendor.driven:
        low, high = (joint.low, joint.high) if legged else _working_range(joint)
        known = {"q_min": low, "q_max": high, "q_home": joint.home, "qd_max": joint.qd_max}
        table = fill(tomlkit.table(), {"name": joint.name}, {})
        fill(table, known | {"acceleration_density": density, "play": 0.0005}, JOINT)
        tables.append(fill(table, {"motor": motors[joint.name], "source": PLACEHOLDER}, {}))
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
        tables.append(fill(tomlkit.table(), asdict(shape), {}))
    return tables
