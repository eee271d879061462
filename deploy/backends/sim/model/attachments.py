"""Attachments of the plant: backlash behind every gear, a payload and a cable."""

import mujoco
import numpy as np

from robots.distributions import Cable
from robots.errors import ConfigError
from robots.spec import RobotSpec

PAYLOAD, LOAD = "firstshift/payload", "firstshift/load"
CABLE, ANCHOR = "firstshift/cable", "firstshift/anchor"


def backlash_name(joint: str) -> str:
    """Return the name of the backlash hinge of a joint."""
    return f"{joint}/backlash"


def add_backlash(joint: mujoco.MjsJoint, nominal: mujoco.MjModel) -> None:
    """Add a second hinge about the same axis, behind the gear, that runs free between two soft stops.

    Source: Isaac Lab's BAM actuators (2025): backlash as a passive hinge. Its stops are as stiff as 1 kHz bears; its
    inertia and damping are those of a gear's last wheel, so small that they only keep it calm: both estimates.
    """
    motor_side = nominal.joint(joint.name)
    hinge = joint.parent.add_joint(
        name=backlash_name(joint.name), type=joint.type, axis=motor_side.axis, pos=motor_side.pos
    )
    hinge.limited, hinge.range, hinge.margin, hinge.ref = True, [-1.0, 1.0], 0.0, 0.0
    hinge.solref_limit, hinge.solimp_limit = [0.004, 1.0], [0.95, 0.99, 0.0005, 0.5, 2.0]
    hinge.armature, hinge.frictionloss, hinge.springref, hinge.springdamper = 1e-3, 0.0, 0.0, [0.0, 0.0]
    hinge.damping, hinge.stiffness = [0.5, 0.0, 0.0], [0.0, 0.0, 0.0]
    hinge.actfrclimited, hinge.actgravcomp = False, False


def add_payload(mjcf: mujoco.MjSpec, nominal: mujoco.MjModel, spec: RobotSpec) -> None:
    """Add a massless body at the tool; without a tool on the base that floats, or on the last link of a mounted arm."""
    if spec.tool:
        tool, carrier = nominal.site(spec.tool), mjcf.site(spec.tool).parent
        payload = carrier.add_body(name=PAYLOAD, pos=tool.pos, quat=tool.quat)
    else:
        carrier = mjcf.body(root_body(nominal) if _floats(nominal) else _last_link(nominal, spec))
        carrier.add_site(name=LOAD)
        payload = carrier.add_body(name=PAYLOAD)
    payload.explicitinertial, payload.mass, payload.inertia = True, 0.0, np.zeros(3)


def root_body(model: mujoco.MjModel) -> str:
    """Return the name of the body that the first joint moves."""
    return str(model.body(int(model.jnt_bodyid[0])).name)


def _floats(model: mujoco.MjModel) -> bool:
    return bool(model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE)


def _last_link(model: mujoco.MjModel, spec: RobotSpec) -> str:
    return str(model.body(int(model.jnt_bodyid[model.joint(spec.joint_names[-1]).id])).name)


def add_cable(mjcf: mujoco.MjSpec, nominal: mujoco.MjModel, cable: Cable, spec: RobotSpec) -> None:
    """Add a tendon from an anchor above the robot to the link that the cable is plugged into, a body of model.xml."""
    names = [nominal.body(i).name for i in range(nominal.nbody)]
    if cable.link not in names:
        known = ", ".join(filter(None, names))
        raise ConfigError(
            f"{spec.folder / 'draws.toml'}: cable.link: found {cable.link!r}, expected a body of model.xml: {known}"
        )
    mjcf.worldbody.add_site(name=ANCHOR, pos=[0.0, 0.0, cable.above_m])
    plug = mjcf.body(cable.link).add_site(
        name=f"{CABLE}/plug", pos=nominal.body_ipos[names.index(cable.link)]
    )
    tendon = mjcf.add_tendon(name=CABLE)
    tendon.wrap_site(ANCHOR)
    tendon.wrap_site(plug.name)
    # No force between the two lengths: a cable pulls, and never pushes.
    tendon.springlength, tendon.stiffness = [0.0, 1.0], [1.0, 0.0, 0.0]
