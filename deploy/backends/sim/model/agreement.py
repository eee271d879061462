"""Agreement of both libraries about a robot: MuJoCo simulates what Pinocchio checks."""

import coal
import mujoco
import numpy as np
import pinocchio as pin

from robots.arrays import Floats
from robots.errors import RobotError
from robots.models.nominal_model import load_pinocchio
from robots.models.pinocchio_model import foot_frames, tool_frame
from robots.spec import RobotSpec

POSES = 8
PLACE_M = 1e-5
"""m by which places may differ."""
SHARE = 1e-3
"""Share of the largest number by which mass matrix and weight may differ."""
PRIMITIVES = [
    int(getattr(mujoco.mjtGeom, f"mjGEOM_{name}"))
    for name in ("SPHERE", "CAPSULE", "ELLIPSOID", "CYLINDER", "BOX")
]
COAL_PRIMITIVES = (coal.Sphere, coal.Capsule, coal.Ellipsoid, coal.Cylinder, coal.Box)
"""Shapes with a middle; of a mesh, MuJoCo's is its centre of mass."""
WRITE_OUT = "write its place into the element itself, outside of any frame"


def check_agreement(spec: RobotSpec, model: mujoco.MjModel) -> None:
    """Compare the model of `load_mujoco` with that of `load_pinocchio`, in the home pose and in random ones.

    Raises:
        RobotError: the mass matrix, the weight, or the place of a tool, foot or shape differs.
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
        joints = [model.joint(name).id for name in spec.joint_names]
        self._qpos, self._dofs = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
        if spec.base:  # at rest in the origin: the nominal model has no base
            self._data.qpos[:7] = 0, 0, 0, 1, 0, 0, 0

    def compare(self, q: Floats) -> None:
        """Compare at joint angles (n,) rad."""
        nominal, nominal_data = self._nominal, self._nominal_data
        self._data.qpos[self._qpos] = q
        mujoco.mj_forward(self._model, self._data)
        pin.framesForwardKinematics(nominal, nominal_data, q)
        pin.updateGeometryPlacements(nominal, nominal_data, self._geometry, self._placements)
        mass, upper = np.zeros((self._model.nv, self._model.nv)), np.triu(pin.crba(nominal, nominal_data, q))
        mujoco.mj_fullM(self._model, self._data, mass)
        self._compare_joints("mass matrix", mass[np.ix_(self._dofs, self._dofs)], upper + np.triu(upper, 1).T)
        weight = pin.computeGeneralizedGravity(nominal, nominal_data, q)
        self._compare_joints("weight", self._data.qfrc_bias[self._dofs], weight)
        for frame in (*tool_frame(self._spec, nominal), *foot_frames(self._spec, nominal)):
            self._compare_frame(nominal.frames[frame].name, nominal_data.oMf[frame].translation)
        if not self._spec.capsules:  # they are not simulated
            self._compare_shapes()

    def _compare_joints(self, what: str, simulated: Floats, nominal: Floats) -> None:
        off = np.abs(simulated - nominal) > SHARE * np.abs(simulated).max()
        if off.any():
            worst = np.unravel_index(np.abs(simulated - nominal).argmax(), off.shape)
            joint = self._spec.joint_names[int(worst[0])]
            found = f"{simulated[worst]:.6g}", f"{nominal[worst]:.6g}"
            self._refuse(f"{what}: joint {joint!r}", *found, "give each body its inertial")

    def _compare_frame(self, name: str, nominal: Floats) -> None:
        site = mujoco.mj_name2id(self._model, mujoco.mjtObj.mjOBJ_SITE, name)
        found = self._data.site(name).xpos if site >= 0 else self._data.body(name).xpos
        if np.abs(found - nominal).max() > PLACE_M:
            self._refuse(f"frame {name!r}", f"{found.round(5)} m", f"{nominal.round(5)} m", WRITE_OUT)

    def _compare_shapes(self) -> None:
        """Compare which shapes have a middle at one place; sizes are left out."""
        model, data = self._model, self._data
        solid = (model.geom_contype | model.geom_conaffinity) != 0
        own = model.geom_bodyid > 0 if self._spec.base else np.ones(model.ngeom, dtype=bool)
        geoms = np.flatnonzero(solid & own & np.isin(model.geom_type, PRIMITIVES))
        shapes = [
            (shape.name, self._placements.oMg[number].translation)
            for number, shape in enumerate(self._geometry.geometryObjects)
            if isinstance(shape.geometry, COAL_PRIMITIVES)
        ]
        nominal = np.array([place for _, place in shapes]).reshape(-1, 3)
        apart = np.abs(data.geom_xpos[geoms][:, None] - nominal).max(axis=2) > PLACE_M
        for geom in geoms[apart.all(axis=1)]:
            name = model.geom(geom).name or f"of body {model.body(model.geom_bodyid[geom]).name}"
            self._refuse(f"geom {name!r}", f"{data.geom_xpos[geom].round(5)} m", "no shape there", WRITE_OUT)
        for shape in np.flatnonzero(apart.all(axis=0)):
            name, place = shapes[shape]
            self._refuse(f"shape {name!r}", "none there", f"{place.round(5)} m", WRITE_OUT)

    def _refuse(self, what: str, simulated: str, nominal: str, mend: str) -> None:
        raise RobotError(
            f"{self._spec.model_path}: {what}: found {simulated} in MuJoCo and {nominal} in Pinocchio, expected the"
            f" same: {mend}"
        )
