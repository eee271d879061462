"""Agreement of both libraries about a robot: MuJoCo simulates what Pinocchio checks."""

import mujoco
import numpy as np
import pinocchio as pin

from robots.arrays import Floats
from robots.errors import RobotError
from robots.models.mujoco_model import not_simulated
from robots.models.nominal_model import load_pinocchio
from robots.models.pinocchio_model import foot_frames, tool_frame
from robots.spec import RobotSpec

POSES = 8
PLACE_M, TURN = 1e-5, 1e-5
"""m, and elements of rotation matrices, by which places may differ."""
SHARE = 1e-3
"""Share by which mass matrix and weight may differ."""
LEAST_KG_M2, LEAST_NM = 1e-9, 1e-6
"""Differences that are rounding, as of a robot whose joints carry no weight."""
_TYPES = mujoco.mjtGeom
SYMMETRY = {
    int(_TYPES.mjGEOM_SPHERE): 0,
    int(_TYPES.mjGEOM_CAPSULE): 1,
    int(_TYPES.mjGEOM_CYLINDER): 1,
    int(_TYPES.mjGEOM_ELLIPSOID): 3,
    int(_TYPES.mjGEOM_BOX): 3,
}
"""Axes that a turn of a shape shows, 1: z alone, whose sign does not matter. MuJoCo moves and turns meshes."""
WRITE_OUT = "write its place into the element itself, outside of any frame"
MEND = {
    "mass matrix": "give each body its inertial",
    "weight": "give each body its inertial, no gravcomp, and the model gravity along −z",
}


def check_agreement(spec: RobotSpec, model: mujoco.MjModel) -> None:
    """Compare the model of `load_mujoco` with that of `load_pinocchio`, in the home pose and in random ones.

    Raises:
        RobotError: the mass matrix, the weight, or the place of a tool, foot or shape differs; or MuJoCo has no room
            to simulate a pose.
    """
    both = _BothModels(spec, model)
    poses = np.random.default_rng(0).uniform(*spec.pose_range, (POSES - 1, spec.n))
    for q in (spec.joint_array("q_home"), *poses):
        both.compare(q)


class _BothModels:
    """A robot in both libraries, in one pose."""

    def __init__(self, spec: RobotSpec, model: mujoco.MjModel) -> None:
        self._spec, self._model, self._data = spec, model, mujoco.MjData(model)
        self._nominal, self._geometry = load_pinocchio(spec)
        self._nominal_data, self._placements = self._nominal.createData(), self._geometry.createData()
        self._shapes = list(self._geometry.geometryObjects)
        joints = [model.joint(name).id for name in spec.joint_names]
        self._qpos, self._dofs = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
        if spec.base:  # at rest in the origin: the nominal model has no base
            self._data.qpos[:7] = 0, 0, 0, 1, 0, 0, 0

    def compare(self, q: Floats) -> None:
        """Compare at joint angles (n,) rad."""
        nominal, nominal_data = self._nominal, self._nominal_data
        self._data.qpos[self._qpos] = q
        self._forward()
        pin.framesForwardKinematics(nominal, nominal_data, q)
        pin.updateGeometryPlacements(nominal, nominal_data, self._geometry, self._placements)
        mass, upper = np.zeros((self._model.nv, self._model.nv)), np.triu(pin.crba(nominal, nominal_data, q))
        mujoco.mj_fullM(self._model, self._data, mass)
        mass = mass[np.ix_(self._dofs, self._dofs)]
        scale = np.sqrt(np.outer(mass.diagonal(), mass.diagonal()))
        nominal_mass = upper + np.triu(upper, 1).T
        self._compare_joints("mass matrix", mass, nominal_mass, LEAST_KG_M2 + SHARE * scale, "kg·m²")
        weight = (self._data.qfrc_bias - self._data.qfrc_gravcomp)[self._dofs]
        allowed = np.full(len(weight), LEAST_NM + SHARE * np.abs(weight).max())
        nominal_weight = pin.computeGeneralizedGravity(nominal, nominal_data, q)
        self._compare_joints("weight", weight, nominal_weight, allowed, "N·m")
        for frame in (*tool_frame(self._spec, nominal), *foot_frames(self._spec, nominal)):
            self._compare_frame(nominal.frames[frame].name, nominal_data.oMf[frame])
        if not self._spec.capsules:  # they are not simulated
            self._compare_shapes()

    def _forward(self) -> None:
        try:
            mujoco.mj_forward(self._model, self._data)
        except mujoco.FatalError as e:
            raise not_simulated(self._spec.model_path, str(e)) from e

    def _compare_joints(
        self, what: str, simulated: Floats, nominal: Floats, allowed: Floats, unit: str
    ) -> None:
        off = np.abs(simulated - nominal) - allowed
        if (off > 0.0).any():
            worst = np.unravel_index(off.argmax(), off.shape)
            joints = " and ".join(dict.fromkeys(repr(self._spec.joint_names[int(place)]) for place in worst))
            found = f"{simulated[worst]:.6g} {unit}", f"{nominal[worst]:.6g} {unit}"
            self._refuse(f"{what}: {joints}", *found, f"{MEND[what]} (within {allowed[worst]:.2g} {unit})")

    def _compare_frame(self, name: str, nominal: pin.SE3) -> None:
        site = mujoco.mj_name2id(self._model, mujoco.mjtObj.mjOBJ_SITE, name)
        found = self._data.site(name) if site >= 0 else self._data.body(name)
        if not _alike(found.xpos, found.xmat.reshape(3, 3), nominal, 3):
            self._refuse(
                f"frame {name!r}",
                _place(found.xpos, found.xmat),
                _place(nominal.translation, nominal.rotation),
                WRITE_OUT,
            )

    def _compare_shapes(self) -> None:
        """Compare the places of shapes, but of meshes only how many there are; sizes are left out."""
        model, data = self._model, self._data
        solid = (model.geom_contype | model.geom_conaffinity) != 0
        own = model.geom_bodyid > 0 if self._spec.base else np.ones(model.ngeom, dtype=bool)
        geoms = [int(geom) for geom in np.flatnonzero(solid & own)]
        shapes = {shape.name: place for shape, place in zip(self._shapes, self._placements.oMg, strict=True)}
        for geom in (geom for geom in geoms if int(model.geom_type[geom]) in SYMMETRY):
            axes, turn = SYMMETRY[int(model.geom_type[geom])], data.geom_xmat[geom].reshape(3, 3)
            if not any(_alike(data.geom_xpos[geom], turn, place, axes) for place in shapes.values()):
                name = model.geom(geom).name or f"of body {model.body(model.geom_bodyid[geom]).name}"
                found = _place(data.geom_xpos[geom], turn)
                self._refuse(f"geom {name!r}", found, "no shape there", WRITE_OUT)
        if len(shapes) != len(geoms):
            self._refuse(
                "shapes", f"{len(geoms)} that touch", f"{len(shapes)}: {', '.join(shapes)}", WRITE_OUT
            )

    def _refuse(self, what: str, simulated: str, nominal: str, mend: str) -> None:
        raise RobotError(
            f"{self._spec.model_path}: {what}: found {simulated} in MuJoCo and {nominal} in Pinocchio, expected the"
            f" same: {mend}"
        )


def _alike(place: Floats, turn: Floats, nominal: pin.SE3, axes: int) -> bool:
    """Return whether a place is the nominal one; of a turn, `axes` axes count."""
    near = bool(np.abs(place - nominal.translation).max() <= PLACE_M)
    if axes == 1:
        return near and abs(float(turn[:, 2] @ nominal.rotation[:, 2])) >= 1.0 - TURN
    return near and (axes == 0 or bool(np.abs(turn - nominal.rotation).max() <= TURN))


def _place(place: Floats, turn: Floats) -> str:
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, np.ascontiguousarray(turn).ravel())
    return f"{place.round(5)} m, quat {quat.round(5)}"
