"""Model of the plant: model.xml, and what only the plant has: backlash, payload, cable, ground, sensors.

All additions are neutral until a draw gives them values.
"""

from dataclasses import dataclass

import mujoco
import numpy as np

from deploy.backends.sim.model import attachments
from deploy.backends.sim.model.agreement import check_agreement
from deploy.backends.sim.model.allowed_contacts import ContactPlaces, add_contacts, find_contacts
from deploy.backends.sim.model.floating_base import FloatingBase, add_ground, find_floating_base
from robots.arrays import Ints
from robots.distributions import Cable
from robots.models.mujoco_model import compile_model, load_mujoco, read_mjcf
from robots.sensors import Kind
from robots.spec import RobotSpec


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantModel:
    """Compiled model of one plant, and the ids of its parts.

    Attributes:
        model: shared by all simulations.
        joints, backlash: (n,) joint ids: on the motor's side, and the backlash between gear and link.
        bodies: (n,) body ids of the links that the joints move.
        link: (bodies,) the joint that moves a body, rigidly attached ones included; -1 for what does not move.
        payload: body id. cable: tendon id. anchor: site id.
        tool: site id of the tool; of a robot without one, of its payload.
        level: id of a body that stays aligned with gravity, however the robot or its floor is tilted; of a robot that
            measures orientation.
        contacts: places of contact sensors, for the judge only.
        base: None for a robot that is mounted.
        beam: of the distance sensor, or None.
        site_sensors: places in `sensordata`, by kind of sensor.
    """

    model: mujoco.MjModel
    joints: Ints
    backlash: Ints
    bodies: Ints
    link: Ints
    payload: int
    cable: int
    anchor: int
    tool: int
    level: int | None
    contacts: ContactPlaces
    base: FloatingBase | None
    beam: attachments.Beam | None
    site_sensors: dict[Kind, slice]

    @property
    def addresses(self) -> Ints:
        """(2, 2, n) of [joints, backlash]: places in [`qpos`, `qvel`]."""
        ids = np.stack((self.joints, self.backlash))
        places = np.stack((self.model.jnt_qposadr[ids], self.model.jnt_dofadr[ids]), axis=1)
        return np.asarray(places, dtype=np.int64)

    @property
    def dofs(self) -> Ints:
        """(n,) places of the joints in `qvel`."""
        return np.asarray(self.model.jnt_dofadr[self.joints], dtype=np.int64)


def build(spec: RobotSpec, cable: Cable) -> PlantModel:
    """Extend model.xml and compile it.

    Raises:
        RobotError: model.xml or a sensor's site makes no sense, or Pinocchio reads another robot from it.
        ConfigError: the cable's link is not in model.xml.
    """
    nominal, mjcf = load_mujoco(spec), read_mjcf(spec)
    check_agreement(spec, nominal)
    _prepare(mjcf)
    for name in spec.joint_names:
        attachments.add_backlash(mjcf.joint(name), nominal)
    add_ground(mjcf, nominal, spec)
    attachments.add_payload(mjcf, nominal, spec)
    attachments.add_cable(mjcf, nominal, cable, spec)
    attachments.add_site_sensors(mjcf, spec)
    attachments.add_beam(mjcf, spec)
    add_contacts(mjcf, nominal, spec)
    model = compile_model(mjcf, spec.model_path)
    # A diverged simulation must be noticed, not silently reset.
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    return _find(model, spec)


def _prepare(mjcf: mujoco.MjSpec) -> None:
    """Undo settings of model.xml that are in the way of the additions."""
    for key in list(mjcf.keys):
        mjcf.delete(key)  # of another size than the state now has
    mjcf.compiler.fusestatic = False  # the payload stays a body of its own
    for geom in mjcf.geoms:
        geom.condim = max(geom.condim, 3)  # every contact has friction, even if model.xml leaves it out


def _find(model: mujoco.MjModel, spec: RobotSpec) -> PlantModel:
    joints = np.array([model.joint(name).id for name in spec.joint_names])
    bodies = model.jnt_bodyid[joints].astype(np.int64)
    link = np.full(model.nbody, -1)
    for joint, body in enumerate(bodies):
        link[model.body_weldid == body] = joint
    return PlantModel(
        model=model,
        joints=joints,
        backlash=np.array([model.joint(attachments.backlash_name(name)).id for name in spec.joint_names]),
        bodies=bodies,
        link=link,
        payload=model.body(attachments.PAYLOAD).id,
        cable=model.tendon(attachments.CABLE).id,
        anchor=model.site(attachments.ANCHOR).id,
        tool=model.site(spec.tool or attachments.LOAD).id,
        level=model.body(attachments.LEVEL).id if "orientation" in spec.sensors else None,
        contacts=find_contacts(model, spec),
        base=find_floating_base(model, spec),
        beam=attachments.find_beam(model, spec),
        site_sensors=attachments.find_site_sensors(model, spec),
    )
