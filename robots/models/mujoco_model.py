"""MuJoCo model of a robot, from the same file as the Pinocchio model."""

from pathlib import Path

import mujoco
import numpy as np

from robots.errors import RobotError
from robots.models.files import is_urdf, referenced_files, urdf_text
from robots.robot_file import BODIES_MAX
from robots.spec import RobotSpec
from robots.tables import Drive, Joint

_INPUT = mujoco.mjtCtrlInput
INPUTS = 3
"""Controls of one `dcmotor` with `input="pos vel ff"`: motor angle, motor speed, motor torque."""
SIGNATURE = sum(int(mode) for mode in (_INPUT.mjINPUT_POS, _INPUT.mjINPUT_VEL, _INPUT.mjINPUT_FF))
"""MuJoCo's bit set of these controls."""
ITERATIONS = (
    "iterations",
    "ls_iterations",
    "noslip_iterations",
    "ccd_iterations",
    "sdf_iterations",
    "sdf_initpoints",
)
"""Options that multiply the time of a step."""
ITERATIONS_MAX = 1000
"""Ten times MuJoCo's default of its solver: a step of more would go on for hours, deaf to Ctrl-C."""
PHYSICS = (
    "constraint",
    "equality",
    "frictionloss",
    "limit",
    "contact",
    "spring",
    "damper",
    "gravity",
    "clampctrl",
    "actuation",
    "sensor",
)
"""Flags that must stay enabled: without one of them a robot that would break or fall passes every test."""
UNSUITABLE = ("override", "sleep", "ipc")
"""Flags that must stay disabled: `override` undoes the drawn friction of contacts, for the others a `Batch` has no
state."""
MEDIUM = ("density", "viscosity", "wind")
"""Options of a medium that brakes the robot: the nominal model has none."""
SIZE_MIB = 256
"""Memory of a compiled model. The H1 with 14 MB of meshes needs 65 MiB, a robot with 50 MB of meshes 188 MiB."""
WORKING_MEMORY = 15 << 20
"""Least bytes for contacts and the solver, whatever a model states for itself: with too few, MuJoCo ends a step."""
SIMULATED = 16
"""Robots that a simulation holds at once: one model and one working memory for all, a state for each."""
USER_NUMBERS = tuple(
    f"nuser_{kind}" for kind in ("body", "jnt", "geom", "site", "cam", "tendon", "actuator", "sensor")
)
"""Sizes of the user's own data, which each element gets that a simulation adds to the model."""
USER_NUMBERS_MAX = 1000


def open_model(model: Path, folder: Path) -> mujoco.MjSpec:
    """Read MJCF or URDF, with enough working memory and no other change.

    Raises:
        RobotError: MuJoCo cannot read it, a file is outside of the folder, or a step may take too many iterations.
    """
    referenced_files(model, folder)
    try:
        if is_urdf(model):
            mjcf = mujoco.MjSpec.from_string(urdf_text(model, folder))
        else:
            mjcf = mujoco.MjSpec.from_file(str(model))
    except (ValueError, RuntimeError, MemoryError, mujoco.FatalError) as e:
        raise _unreadable(model, e) from e
    for name in ITERATIONS:
        if (found := getattr(mjcf.option, name)) > ITERATIONS_MAX:
            raise RobotError(f"{model}: option {name}: found {found}, expected at most {ITERATIONS_MAX}")
    if 0 <= mjcf.memory < WORKING_MEMORY:
        mjcf.memory = WORKING_MEMORY
    return mjcf


def compile_model(mjcf: mujoco.MjSpec, model: Path) -> mujoco.MjModel:
    """Compile a model that was read from a file; RobotError with MuJoCo's message if it cannot."""
    try:
        return mjcf.compile()
    except (ValueError, RuntimeError, MemoryError, mujoco.FatalError) as e:
        raise _unreadable(model, e) from e


def check_size(compiled: mujoco.MjModel, model: Path) -> None:
    """Refuse a model of unknown origin that takes too much memory: processes that use it have no limit of their own.

    Raises:
        RobotError: it needs more than `SIZE_MIB`, has more than `BODIES_MAX` bodies, or its elements hold more than
            `USER_NUMBERS_MAX` numbers each.
    """
    if (bodies := compiled.nbody - 1) > BODIES_MAX:  # without the world
        raise RobotError(f"{model}: found {bodies} bodies, expected at most {BODIES_MAX}")
    for name in USER_NUMBERS:
        if (found := getattr(compiled, name)) > USER_NUMBERS_MAX:
            raise RobotError(f"{model}: size {name}: found {found}, expected at most {USER_NUMBERS_MAX}")
    numbers = mujoco.mj_stateSize(compiled, mujoco.mjtState.mjSTATE_INTEGRATION)
    size = compiled.nbuffer + compiled.narena + SIMULATED * 8 * numbers
    if size <= SIZE_MIB << 20:
        size += mujoco.MjData(compiled).nbuffer
    if size > SIZE_MIB << 20:
        raise RobotError(
            f"{model}: found {size / (1 << 20):.0f} MiB of memory once compiled, expected at most {SIZE_MIB} MiB"
        )


def read_mjcf(spec: RobotSpec) -> mujoco.MjSpec:
    """Read the model at the robot's physics rate, with the drives of robot.toml, to compile or to add to.

    Raises:
        RobotError: MuJoCo cannot read it, it changes the physics, or it lacks a part that robot.toml names.
    """
    mjcf = open_model(spec.model_path, spec.folder)
    _check_physics(mjcf, spec.model_path)
    if spec.base and is_urdf(spec.model_path):  # URDF cannot declare a free root
        mjcf.worldbody.bodies[0].add_freejoint()
    mjcf.option.timestep = 1.0 / spec.rates.physics_hz
    for element in (*mjcf.keys, *mjcf.sensors):  # they refer to actuators and joints that may be removed
        mjcf.delete(element)
    _lock(mjcf, spec)
    if spec.drives:
        _drive(mjcf, spec)
    bodies = [body.name for body in mjcf.bodies]
    for pair in spec.neighbours:
        for body in pair:
            spec.check_known("neighbours", body, "a body", bodies)
        mjcf.add_exclude(bodyname1=pair[0], bodyname2=pair[1])
    _exclude_mount(mjcf)
    if spec.tool and mjcf.site(spec.tool) is None and (body := mjcf.body(spec.tool)) is not None:
        body.add_site(name=spec.tool)
    return mjcf


def _check_physics(mjcf: mujoco.MjSpec, model: Path) -> None:
    """Refuse (RobotError) options that change the physics. Drafts can be made from such a model, simulations cannot."""
    for name in MEDIUM:
        if np.any(found := getattr(mjcf.option, name)):
            raise RobotError(f"{model}: option {name}: found {found}, expected 0")
    for name in PHYSICS:
        if mjcf.option.disableflags & getattr(mujoco.mjtDisableBit, f"mjDSBL_{name.upper()}"):
            raise RobotError(f"{model}: option flag {name}: found 'disable', expected 'enable'")
    for name in UNSUITABLE:
        if mjcf.option.enableflags & getattr(mujoco.mjtEnableBit, f"mjENBL_{name.upper()}"):
            raise RobotError(f"{model}: option flag {name}: found 'enable', expected 'disable'")


def _lock(mjcf: mujoco.MjSpec, spec: RobotSpec) -> None:
    """Remove locked joints, and whatever else moves or holds them."""
    for name in spec.locked:
        spec.check_known("locked", name, "joints", (joint.name for joint in mjcf.joints))
    joints = [joint for joint in mjcf.joints if joint.name in spec.locked]
    for joint in joints:
        if joint.ref != 0.0:
            raise RobotError(
                f"{spec.model_path}: joint {joint.name!r}: ref: found {joint.ref:g}, expected 0: it is locked"
            )
    tendons = [tendon for tendon in mjcf.tendons if any(wrap.target in joints for wrap in tendon.path)]
    gone = {element.name for element in (*joints, *tendons)} - {""}
    held = [equality for equality in mjcf.equalities if {equality.name1, equality.name2} & gone]
    moved = [actuator for actuator in mjcf.actuators if actuator.target in gone]
    for element in (*held, *moved, *tendons, *joints):
        mjcf.delete(element)


def _exclude_mount(mjcf: mujoco.MjSpec) -> None:
    """Exclude contacts of the first link with its mount: MuJoCo excludes parent and child only where both can move."""
    fixed, excluded = {"world"}, {frozenset((each.bodyname1, each.bodyname2)) for each in mjcf.excludes}
    for body in mjcf.bodies[1:]:
        if body.parent.name not in fixed:
            continue
        if not body.joints:
            fixed.add(body.name)
            continue
        for mount in sorted(fixed - {"world", ""}):
            if body.name and frozenset((mount, body.name)) not in excluded:
                mjcf.add_exclude(bodyname1=mount, bodyname2=body.name)


def _drive(mjcf: mujoco.MjSpec, spec: RobotSpec) -> None:
    if any(actuator.dyntype == mujoco.mjtDyn.mjDYN_DCMOTOR for actuator in mjcf.actuators):
        raise RobotError(
            f"{spec.folder / 'robot.toml'}: motors.{spec.joints[0].motor}.drive: {spec.model_path.name} has a dcmotor"
            " as well, expected drives in one of the two"
        )
    for actuator in mjcf.actuators:
        mjcf.delete(actuator)
    # The other integrators are unstable with stiff drives.
    mjcf.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    for joint, drive in zip(spec.joints, spec.drives, strict=True):
        _add_drive(mjcf, joint, drive, spec)


def _add_drive(mjcf: mujoco.MjSpec, driven: Joint, drive: Drive, spec: RobotSpec) -> None:
    """Add one drive. Its gains are at the motor, where an error of the joint is `gear` times as large."""
    joint = mjcf.joint(driven.name)
    if joint is None:
        known = tuple(joint.name for joint in mjcf.joints)
        raise RobotError(f"{spec.model_path}: joints are {known}; robot.toml lists {spec.joint_names}")
    if not joint.actfrcrange[1] > 0:
        most = _needed(drive.torque_max, "torque_max", "actuatorfrcrange", driven, spec)
        joint.actfrclimited, joint.actfrcrange = True, [-most, most]
    if not joint.armature > 0:
        joint.armature = _needed(drive.armature, "armature", "armature", driven, spec)
    motor = mjcf.add_actuator(name=driven.name, target=driven.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    _set_motor(motor, drive, joint.actfrcrange[1])


def _set_motor(motor: mujoco.MjsActuator, drive: Drive, torque_max: float) -> None:
    motor.gear[0] = drive.gear
    motor.set_to_dcmotor(
        motorconst=[drive.torque_constant] * 2,
        resistance=drive.resistance_ohm,
        saturation=[torque_max / drive.gear, 0.0, 0.0],
        controller=[drive.kp / drive.gear**2, 0.0, drive.kd / drive.gear**2, 0.0, 0.0, drive.supply_v],
        thermal=[
            drive.winding_resistance_k_per_w,
            drive.winding_capacity_j_per_k,
            0.0,
            drive.copper_per_k,
            drive.reference_c,
            drive.reference_c,
        ],
        ctrlspec=SIGNATURE,
    )


def _needed(value: float | None, field: str, theirs: str, joint: Joint, spec: RobotSpec) -> float:
    if value is None:
        raise RobotError(
            f"{spec.folder / 'robot.toml'}: motors.{joint.motor}.drive.{field}: missing, and joint {joint.name} has no"
            f" {theirs} in {spec.model_path.name}"
        )
    return value


def load_mujoco(spec: RobotSpec) -> mujoco.MjModel:
    """Compile the model at the physics rate; refuse (RobotError) other joints, drives or tool than robot.toml's."""
    path, model = spec.model_path, compile_model(read_mjcf(spec), spec.model_path)
    free = model.jnt_type == mujoco.mjtJoint.mjJNT_FREE
    if free.any() != (spec.base is not None):
        raise RobotError(
            f"{path}: found {free.sum()} free joints, expected as many as robot.toml has tables base"
        )
    joints = tuple(model.joint(i).name for i in np.flatnonzero(~free))
    if joints != spec.joint_names:
        raise RobotError(f"{path}: joints are {joints}; robot.toml lists {spec.joint_names}")
    _check_drives(spec, model)
    if spec.tool and spec.tool not in {model.site(i).name for i in range(model.nsite)}:
        raise RobotError(f"{path}: no site or body named {spec.tool!r}, which robot.toml calls the tool")
    return model


def _check_drives(spec: RobotSpec, model: mujoco.MjModel) -> None:
    driven = tuple(model.joint(model.actuator(i).trnid[0]).name for i in range(model.nactuator))
    if driven != spec.joint_names or model.nu != INPUTS * spec.n or model.na != spec.n:
        raise RobotError(
            f"{spec.model_path}: drives move {driven} with {model.nu} controls and {model.na} states; expected one"
            f' dcmotor for each of {spec.joint_names} with input="pos vel ff" and thermal'
        )


def not_simulated(model: Path, message: str) -> RobotError:
    """Return the error of a model that MuJoCo compiles but cannot simulate, with the first line of its message."""
    return RobotError(f"{model}: MuJoCo cannot simulate it: {message.partition(chr(10))[0]:.300}")


def _unreadable(model: Path, why: Exception) -> RobotError:
    return RobotError(
        f"{model}: MuJoCo cannot read it: {'; '.join(filter(None, str(why).splitlines())):.300}"
    )
