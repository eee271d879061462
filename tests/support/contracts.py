from hypothesis import strategies as st

from deploy.policy.contract import Contract
from deploy.policy.contract_action import ActionSpec
from deploy.policy.contract_term import Term
from deploy.tasks.task import installed_sources, sources_of
from support.arm6 import SPEC

POSITIVE = st.floats(min_value=0, exclude_min=True, allow_infinity=False)
FINITE = st.floats(allow_nan=False, allow_infinity=False)
BOUNDS = st.tuples(FINITE, FINITE).filter(lambda c: c[0] < c[1])


def term(source, size, **changes):
    declared = installed_sources()[source]
    fields = {"name": source, "source": source, "size": size}
    fields |= {"frame": declared.frame, "unit": declared.unit}
    if source == "gait_phase":
        fields["period_s"] = 0.8
    return Term(**{**fields, "scale": (1.5,) * size, **changes})


def arm_contract(**changes):
    """The contract that the arm's policy has."""
    sizes = {
        "joint_position": 6,
        "joint_velocity": 6,
        "tool_position": 3,
        "goal_from_tool": 3,
        "goal_torque": 6,
        "last_action": 6,
    }
    action = ActionSpec(mode="position_increment", size=6, scale=(0.05,) * 6, clip=(-1.0, 1.0), leash_rad=0.3)
    fields = {
        "robot": "arm6",
        "robot_digest": SPEC.digest,
        "joint_names": SPEC.joint_names,
        "policy_hz": 50,
        "control_hz": 200,
        "task": "reach",
        "observation": tuple(term(source, size) for source, size in sizes.items()),
        "action": action,
        "trained": {"recipe": "by hand"},
    }
    return Contract(**{**fields, **changes})


@st.composite
def terms(draw, name):
    source = draw(st.sampled_from(sorted(sources_of("reach"))))
    size = draw(st.integers(1, 8))
    scale = draw(st.lists(POSITIVE, min_size=size, max_size=size).map(tuple))
    clip, history = draw(st.none() | BOUNDS), draw(st.integers(1, 5))
    offset = draw(st.none() | st.lists(FINITE, min_size=size, max_size=size).map(tuple))
    return term(source, size, name=name, scale=scale, offset=offset, clip=clip, history=history)


@st.composite
def contracts(draw):
    names = draw(st.lists(st.text(min_size=1, max_size=9), min_size=1, max_size=5, unique=True))
    joints = tuple(draw(st.lists(st.text(min_size=1, max_size=20), min_size=1, max_size=8)))
    action = ActionSpec(
        mode="position_increment",
        size=len(joints),
        scale=draw(st.lists(POSITIVE, min_size=len(joints), max_size=len(joints)).map(tuple)),
        clip=draw(BOUNDS),
        leash_rad=draw(POSITIVE),
    )
    policy_hz, times = draw(st.integers(1, 500)), draw(st.integers(1, 20))
    return arm_contract(
        joint_names=joints,
        observation=tuple(draw(terms(name)) for name in names),
        action=action,
        policy_hz=policy_hz,
        control_hz=policy_hz * times,
        trained=draw(st.dictionaries(st.text(min_size=1, max_size=9), st.text(), max_size=3)),
    )


NAMES = SPEC.joint_names
SWAPPED = (NAMES[1], NAMES[0], *NAMES[2:])
