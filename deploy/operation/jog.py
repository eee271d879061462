"""Jogging: one joint at a time by small steps, at reduced speed, without a policy file.

`Jog` stands in the place of a policy: the same estimator, smoother, checks and supervisor.
"""

import hashlib

import numpy as np

from deploy.policy.actor import Actor
from deploy.policy.contract import Contract
from deploy.policy.contract_action import ActionSpec
from deploy.policy.contract_term import Term
from deploy.sources.catalogue import SOURCES
from deploy.tasks.task import NoGoal
from robots.arrays import Bools, Float32s, Floats
from robots.spec import RobotSpec

SPEED_SHARE = 0.05
"""Share of the speed limit of setpoints at which a joint is moved by hand."""
TOOL_SPEED = 0.25
"""m/s, largest speed of the tool. Source: ISO 10218-1, reduced speed in manual mode."""
LEASH_RAD = 0.03
"""rad by which the target may lead the setpoint: more than a joint at reduced speed needs to brake."""
ROUNDING_RAD = 1e-9


def reduced_speed(spec: RobotSpec) -> RobotSpec:
    """Return the robot with the speed limits of manual mode, which its smoother and its checks then keep.

    Without a bound on oscillation: noise of the estimate turns a speed that small around.
    """
    margins = spec.margins
    slow = {
        "speed": SPEED_SHARE * margins.speed,
        "tool_speed": margins.tool_speed or margins.speed,
        "oscillation_hz": None,
    }
    changes: dict[str, object] = {"margins": margins.model_copy(update=slow)}
    if spec.workspace:
        speed = min(TOOL_SPEED, spec.workspace.tool_speed_max)
        changes["workspace"] = spec.workspace.model_copy(update={"tool_speed_max": speed})
    return spec.model_copy(update=changes)


def jog_contract(spec: RobotSpec) -> Contract:
    """Return the contract by which a full action moves a joint of a robot at its largest speed, in every tick."""
    source = SOURCES["joint_position"]
    angles = Term(
        name="joint_position",
        source="joint_position",
        frame=source.frame,
        unit=source.unit,
        size=spec.n,
        scale=(1.0,) * spec.n,
    )
    steps = spec.margins.speed * spec.joint_array("qd_max") * spec.dt
    action = ActionSpec(
        mode="position_increment",
        size=spec.n,
        scale=tuple(steps.tolist()),
        clip=(-1.0, 1.0),
        leash_rad=LEASH_RAD,
    )
    return Contract(
        robot=spec.name,
        robot_digest=spec.digest,
        joint_names=spec.joint_names,
        policy_hz=spec.rates.control_hz,
        control_hz=spec.rates.control_hz,
        task=NoGoal.name,
        observation=(angles,),
        action=action,
        trained={"recipe": "none: an operator moves the joints"},
    )


class Jog(Actor):
    """Motion of one joint at a time, for robot 0; every other joint and robot keeps its target.

    Attributes:
        to_go: (B, n) rad, rest of the motion asked for.
    """

    carried = ("to_go",)
    to_go: Floats

    def __init__(self, spec: RobotSpec) -> None:
        """Take a robot at the speed that it is to be moved at: see `reduced_speed`."""
        self.contract = jog_contract(spec)
        self.digest = hashlib.sha256(self.contract.to_json().encode()).hexdigest()
        self._step = np.array(self.contract.action.scale)
        self.resize(1)

    def move(self, joint: int, angle: float) -> None:
        """Move a joint by `angle` rad from its present target; any motion asked for before ends there."""
        self.stop()
        self.to_go[0, joint] = angle

    def stop(self) -> None:
        """Ask for no further motion."""
        self.to_go[:] = 0.0

    @property
    def moving(self) -> bool:
        """True until the target has moved as far as was asked for."""
        return bool((np.abs(self.to_go) > ROUNDING_RAD).any())

    def step(self, observation: Float32s) -> Float32s:
        """Return the share of a step (B, n) by which each target moves now."""
        del observation
        share = np.clip(self.to_go / self._step, -1.0, 1.0)
        self.to_go -= share * self._step
        action: Float32s = share.astype(np.float32)
        return action

    def reset(self, ids: Bools) -> None:
        """Ask for no motion of robots where `ids` (B,) holds."""
        self.to_go[ids] = 0.0

    def resize(self, robots: int) -> None:
        """Allocate for B robots, none of them moving."""
        self.to_go = np.zeros((robots, len(self._step)))
