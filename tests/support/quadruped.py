"""The shipped quadruped, contracts for it with the egocentric observation, and a policy that stands."""

import numpy as np
from onnx import helper

from deploy.policy.contract import Contract
from deploy.policy.contract_action import ActionSpec
from deploy.sources.maximum import Scale
from deploy.sources.templates import observation_sources, physical_maxima
from deploy.tasks.task import find_task, sources_of
from robots.spec import load_robot
from support.contracts import term
from support.faulty_policies import written

QUADRUPED = load_robot("quadruped")
HOME = QUADRUPED.joint_array("q_home")
EGOCENTRIC = 3 + 2 + 2 + 12 + 12 + 4 + 1
"""Numbers of the template without the command."""


def quadruped_contract(spec=QUADRUPED, task="velocity", observation="egocentric", **changes):
    """Angles around the home pose, ±0.5 rad for full actions, on the robot's own drives."""
    known, scale = sources_of(task), Scale(spec, 1.0, 1.0)
    names = observation_sources(observation, known, spec, "here", find_task(task, "here").command)
    maxima = {name: physical_maxima(name, known[name], scale, "here") for name in names}
    fields = {
        "robot": spec.name,
        "robot_digest": spec.digest,
        "joint_names": spec.joint_names,
        "policy_hz": 50,
        "control_hz": spec.rates.control_hz,
        "task": task,
        "observation": tuple(term(name, len(found), scale=found) for name, found in maxima.items()),
        "action": ActionSpec(
            mode="position",
            size=spec.n,
            offset=tuple(spec.joint_array("q_home")),
            scale=(0.5,) * spec.n,
            clip=(-1.0, 1.0),
        ),
        "trained": {"recipe": "by hand"},
    }
    return Contract(**{**fields, **changes})


def standing_policy(folder, contract=None):
    """The file of a policy that asks for the home pose, whatever it observes."""
    contract = contract or quadruped_contract()
    w = np.zeros((contract.observation_size, contract.action_size), np.float32)
    return written(folder, [helper.make_node("MatMul", ["observation", "w"], ["action"])], {"w": w}, contract)
