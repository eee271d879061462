"""robot.toml, draws.toml and limits.toml of a new robot: what its model knows, estimates that say so, and "?"."""

import tomllib
from collections.abc import Mapping
from typing import Any

import tomlkit
from tomlkit.items import AoT, Table

from policies.robot_init import legged_defaults
from policies.robot_init.vendor_model import Facts, JointFacts
from robots.spec import ROBOTS
from robots.strict import PLACEHOLDER

EXAMPLE = ROBOTS / "arm6"
"""Where estimates come from that hold for most robots of its size."""
INSIDE = 0.02
"""Share of a joint's range that working limits stay inside, at each end. Legs use all of theirs."""
SENSORS = ("encoder", "current", "temperature")
ESTIMATE = "estimate, to be replaced by the data sheet"

HEAD = """{name}: what the model says is filled in. "?" is to be filled in; look at what is called an estimate.
SI units unless a key ends in one. Keys are explained in robots/spec.py, tables.py and drive.py."""
MOTOR = {
    "housing_resistance_k_per_w": "K/W, housing to ambient",
    "housing_capacity_j_per_k": "J/K",
    "iron_w_s2": "W/(rad/s)² of the motor's shaft, eddy currents",
    "winding_soft_c": "°C, where it is asked for less",
    "winding_max_c": "°C, where damage begins",
    "housing_soft_c": "°C",
    "housing_max_c": "°C",
    "source": "where the numbers come from",
}
DRIVE = {
    "gear": "turns of the motor for one of the joint",
    "torque_constant": "N·m/A of the motor, without its gear",
    "resistance_ohm": "of the winding at reference_c",
    "reference_c": "°C",
    "copper_per_k": "1/K, copper",
    "winding_resistance_k_per_w": "K/W, winding to housing",
    "winding_capacity_j_per_k": "J/K, the winding's time constant over the resistance before",
    "supply_v": "V",
    "kp": "N·m/rad at the joint",
    "kd": "N·m·s/rad at the joint",
    "torque_max": "N·m at the joint",
    "armature": "kg·m² of the rotor, times gear²",
}
JOINT = {
    "q_min": "rad",
    "q_max": "rad",
    "q_home": "rad, where it rests and work begins",
    "qd_max": "rad/s, what the drive may do",
    "qdd_max": "rad/s², what it is asked to do",
    "qddd_max": "rad/s³",
    "acceleration_density": "rad²/s³, estimate: see robots/tables.py",
    "play": "rad, estimate",
}
KNOWN_OF_DRIVES = {"reference_c": 25.0, "copper_per_k": 0.0039}


def robot_toml(
    facts: Facts, name: str, model: str, neighbours: tuple[tuple[str, str], ...]
) -> tomlkit.TOMLDocument:
    """The text of robot.toml."""
    document = _commented(HEAD.format(name=name))
    example = tomllib.loads((EXAMPLE / "robot.toml").read_text(encoding="utf-8"))
    document |= {"name": name, "model": model}
    if not facts.floats:
        known = ", ".join((*facts.sites, *facts.bodies))
        document.add("tool", _said(facts.tool, f"a site or a body: {known}"))
    if facts.locked:
        document.add("locked", _said(list(facts.locked), "slides, and what no actuator of the model moves"))
    if neighbours:
        near = _said([list(pair) for pair in neighbours], "excluded by the model, or near in every pose")
        document.add("neighbours", near)
    document.add("rates", tomlkit.item(legged_defaults.RATES if facts.floats else example["rates"]))
    document.add("margins", _margins(facts, example["margins"]))
    if facts.floats:
        document.add("base", _table(legged_defaults.base(facts), legged_defaults.asked(facts)))
    else:
        document.add("workspace", _workspace(facts, example["workspace"]))
    document.add("sensors", _sensors(facts, example["sensors"]))
    motors = _motors(facts)
    document.add("motors", _motor_tables(facts, motors))
    document.add("joints", _joints(facts, motors))
    if facts.shapes and not facts.plain:
        document.add("capsules", _capsules(facts))
    return document


def draws_toml(facts: Facts) -> tomlkit.TOMLDocument:
    """The example's, all of whose numbers are estimates or of the field, with the cable on a link of this robot."""
    document = tomlkit.parse((EXAMPLE / "draws.toml").read_text(encoding="utf-8"))
    bodies = [joint.body for joint in facts.joints if joint.name not in facts.locked]
    cable = document["cable"]
    cable["link"] = bodies[len(bodies) // 2] if bodies else PLACEHOLDER
    cable["above_m"] = round(facts.centre[2] + 1.2 * facts.reach, 2)
    if facts.floats:  # it walks away from where the cable hangs
        cable["stiffness_n_per_m"].update({"low": 0.0, "high": 0.0, "log": False})
    return document


def limits_toml(facts: Facts, name: str) -> tomlkit.TOMLDocument:
    """The judge's own; what depends on the size of the robot is open."""
    document = _commented(
        f"What a soak's judge holds {name} to beside robot.toml; explained in eval/judge/limits.py."
    )
    example = tomllib.loads((EXAMPLE / "limits.toml").read_text(encoding="utf-8"))
    left_out = {"motors", "manipulability"} if facts.floats else {"motors"}
    asked = {"power_w": PLACEHOLDER} | (
        legged_defaults.LIMITS | {"contact_n": PLACEHOLDER} if facts.floats else {}
    )
    document |= {key: value for key, value in example.items() if key not in left_out} | asked
    motors = {
        motor: {"power_w": PLACEHOLDER, "torque_rate": PLACEHOLDER, "source": PLACEHOLDER}
        for motor in set(_motors(facts).values())
    }
    document.add("motors", tomlkit.item(dict(sorted(motors.items()))))
    return document


def _commented(text: str) -> tomlkit.TOMLDocument:
    document = tomlkit.document()
    for line in text.splitlines():
        document.add(tomlkit.comment(line))
    return document


def _said(value: Any, meaning: str) -> Any:
    """A value, or "?" for None, with its meaning behind it."""
    item = tomlkit.item(PLACEHOLDER if value is None else value)
    return item.comment(meaning)


def _table(values: Mapping[str, Any], asked: Mapping[str, str]) -> Table:
    table = tomlkit.table()
    for key, meaning in asked.items():
        table.add(key, _said(values.get(key), meaning))
    return table


def _workspace(facts: Facts, example: Mapping[str, Any]) -> Table:
    table = tomlkit.table()
    table.add("z_min", _said(0.03, "m; estimate: above a table at z = 0"))
    table.add("radius_max", _said(facts.reach or None, "m; the arm stretched to its last body"))
    table.add("centre", _said(list(facts.centre), "m, of the first joint"))
    table.add("tool_speed_max", _said(example["tool_speed_max"], "m/s; estimate"))
    return table


def _margins(facts: Facts, example: Mapping[str, Any]) -> Table:
    walks = legged_defaults.MARGINS if facts.floats else {}
    left_out = legged_defaults.NO_TOOL if facts.floats else ()
    margins = {key: value for key, value in {**example, **walks}.items() if key not in left_out}
    table = tomlkit.table()
    table.update(margins)
    table.comment("estimates, most of them as arm6")
    return table


def _sensors(facts: Facts, example: Mapping[str, Any]) -> Any:
    found = {kind: example[kind] for kind in SENSORS}
    found = legged_defaults.sensors(facts, found) if facts.floats else {**found, "goal": example["goal"]}
    return tomlkit.item({kind: {**sensor, "source": ESTIMATE} for kind, sensor in found.items()})


def _motors(facts: Facts) -> dict[str, str]:
    """The motor of each driven joint: joints of which the model says the same have the same."""
    kinds: dict[tuple[Any, ...], str] = {}
    found = {}
    for joint in _driven(facts):
        alike = (joint.torque_range, joint.torque_max, joint.kp, joint.kd, joint.gear, joint.armature)
        found[joint.name] = kinds.setdefault(alike, f"motor{len(kinds) + 1}")
    return found


def _driven(facts: Facts) -> list[JointFacts]:
    return [joint for joint in facts.joints if joint.name not in facts.locked]


def _motor_tables(facts: Facts, motors: Mapping[str, str]) -> Table:
    table = tomlkit.table(is_super_table=True)
    for joint in _driven(facts):
        name = motors[joint.name]
        if name in table:
            continue
        motor = _table({}, MOTOR)
        if not facts.drives:
            known = {"gear": joint.gear, "kp": joint.kp, "kd": joint.kd, "torque_max": joint.torque_max}
            said = {"torque_max": joint.torque_range is not None, "armature": joint.armature > 0}
            asked = {key: meaning for key, meaning in DRIVE.items() if not said.get(key)}
            motor.add("drive", _table(KNOWN_OF_DRIVES | known, asked))
        table.add(name, motor)
    return table


def _joints(facts: Facts, motors: Mapping[str, str]) -> AoT:
    tables = tomlkit.aot()
    estimates = {"acceleration_density": legged_defaults.RESTLESS if facts.floats else 0.02, "play": 0.0005}
    for joint in _driven(facts):
        low, high = (joint.low, joint.high) if facts.floats else _inside(joint)
        known = {"q_min": low, "q_max": high, "q_home": joint.home, "qd_max": joint.qd_max}
        table = tomlkit.table()
        table.add("name", joint.name)
        for key, item in _table(known | estimates, JOINT).items():
            table.add(key, item)
        table.add("motor", motors[joint.name])
        table.add("source", PLACEHOLDER)
        tables.append(table)
    return tables


def _inside(joint: JointFacts) -> tuple[float | None, float | None]:
    """rad, working limits a little inside of the mechanical ones."""
    if joint.low is None or joint.high is None:
        return None, None
    margin = INSIDE * (joint.high - joint.low)
    return round(joint.low + margin, 4), round(joint.high - margin, 4)


def _capsules(facts: Facts) -> AoT:
    tables = tomlkit.aot()
    for shape in facts.shapes:
        table = tomlkit.table()
        table |= {
            "body": shape.body,
            "start": list(shape.start),
            "end": list(shape.end),
            "radius": shape.radius,
        }
        tables.append(table)
    return tables
