"""Contacts that are allowed, those that are not, and a goal that can be touched."""

import mujoco
import numpy as np
import pytest

from deploy.backends.sim.model.allowed_contacts import GOAL_RADIUS_M, PARKED
from deploy.backends.sim.model.plant_model import build
from eval.shard.judging import judge_tick, make_judge
from robots.distributions import load_distributions
from robots.draws import median_draw
from robots.errors import RobotError
from robots.models.fleet import Fleet
from robots.models.nominal_model import load_pinocchio
from robots.randomness import robot_seed
from robots.spec import load_robot
from support.arm6 import SPEC, complaint, copy_of_arm
from support.contracts import arm_contract, term
from support.deploy.plants import DT, HOME, PLAIN, command, exact
from support.runtimes import simulate

TOUCH = '[[may_touch]]\nbodies = ["wrist_3_link", "goal"]\nforce_n = {}\n\n[sensors.encoder]'


def touching(folder, force_n=30.0):
    """The arm that may touch the goal with its last link."""
    return load_robot(copy_of_arm(folder, toml=[(r"\[sensors\.encoder\]", TOUCH.format(force_n))]))


@pytest.fixture(scope="module")
def spec(tmp_path_factory):
    return touching(tmp_path_factory.mktemp("touch"))


def hold(plant, q, goal, ticks):
    for _ in range(ticks):
        plant.contacts.show(np.tile(goal, (len(plant.q), 1)))
        plant.step(command(q))
    return plant.truth(0.0)


def tool_and_push(plant, depth_m):
    """Tool (3,), its direction (3,), and the change of angles (n,) that moves it so far in that direction."""
    model, data, jacobian = (
        plant.batch.get_model(0),
        plant.batch.get_data(0),
        np.zeros((3, plant.batch.model.nv)),
    )
    mujoco.mj_forward(model, data)
    tool = data.site("tool")
    mujoco.mj_jacSite(model, data, jacobian, None, tool.id)
    along = tool.xmat.reshape(3, 3)[:, 2]
    return tool.xpos.copy(), along, np.linalg.pinv(jacobian[:, plant.dofs]) @ (depth_m * along)


def forces_by_mujoco(plant):
    """Normal forces of all contacts, with the names of their geoms."""
    model, data = plant.batch.get_model(0), plant.batch.get_data(0)
    mujoco.mj_forward(model, data)
    force, found = np.zeros(6), {}
    for k in range(data.ncon):
        mujoco.mj_contactForce(model, data, k, force)
        names = frozenset(model.geom(geom).name for geom in data.contact[k].geom)
        found[names] = force[0]
    return found


def test_a_tool_may_press_on_the_goal(spec):
    plant = exact(1, spec=spec)
    tool, along, push = tool_and_push(plant, 0.008)
    goal = tool + (GOAL_RADIUS_M + 0.003) * along
    truth = hold(plant, HOME, goal, 5)
    assert not truth.self_collision.any()
    assert truth.allowed_contact_n.tolist() == [[0.0]]
    truth = hold(plant, HOME + push, goal, 200)
    by_mujoco = forces_by_mujoco(plant)
    assert set(by_mujoco) == {frozenset(("goal", "wrist_3"))}
    (force,) = by_mujoco.values()
    assert force > 5.0
    assert truth.allowed_contact_n[0, 0] == pytest.approx(force, rel=0.02)
    assert not truth.self_collision.any()
    assert truth.contact_n.tolist() == [0.0]


def test_any_other_link_on_the_goal_is_a_collision(spec):
    plant = exact(1, spec=spec)
    model, data = plant.batch.get_model(0), plant.batch.get_data(0)
    mujoco.mj_forward(model, data)
    forearm, turned = data.geom("forearm").xpos.copy(), HOME.copy()
    turned[0] += 0.1
    aside = np.cross([0.0, 0.0, 1.0], forearm * [1.0, 1.0, 0.0])
    goal = forearm + aside / np.linalg.norm(aside) * (0.04 + GOAL_RADIUS_M + 0.01)
    assert not hold(plant, HOME, goal, 5).self_collision.any()
    truth = hold(plant, turned, goal, 100)
    assert truth.self_collision.all()
    assert truth.contact_n[0] > 1.0
    assert truth.allowed_contact_n.tolist() == [[0.0]]


def test_collisions_without_the_goal_are_found_as_ever(spec):
    plant, down = exact(1, spec=spec), HOME.copy()
    down[1], down[2] = -0.05, 0.3
    tool, along, _ = tool_and_push(plant, 0.0)
    plant.reset(np.ones(1, dtype=bool), down[None])
    truth = hold(plant, down, tool + 0.2 * along, 5)
    assert truth.self_collision.all()
    usual = exact(1)
    usual.reset(np.ones(1, dtype=bool), down[None])
    assert truth.contact_n[0] == pytest.approx(hold(usual, down, tool, 5).contact_n[0], rel=1e-6)


def test_a_goal_that_appears_inside_the_robot_is_solid_once_it_is_free(spec):
    plant = exact(1, spec=spec)
    model, data = plant.batch.get_model(0), plant.batch.get_data(0)
    mujoco.mj_forward(model, data)
    goal, away = data.geom("forearm").xpos.copy(), HOME.copy()
    away[0] += 0.6
    truth = hold(plant, HOME, goal, 50)
    assert not truth.self_collision.any()
    assert not truth.contact_n.any()
    assert np.abs(plant.q[0] - HOME).max() < 0.01
    assert not plant.contacts.solid.any()
    assert not hold(plant, away, goal, 300).self_collision.any()
    assert plant.contacts.solid.all()
    assert hold(plant, HOME, goal, 300).self_collision.all()


def test_a_goal_on_the_table_touches_nothing_and_none_is_far_away(spec):
    plant = exact(1, spec=spec)
    assert not hold(plant, HOME, np.array([0.5, 0.5, 0.0]), 5).self_collision.any()
    assert plant.contacts.solid.all()
    hold(plant, HOME, np.full(3, np.nan), 2)
    np.testing.assert_array_equal(plant.batch.bind("mocap_pos")[0, 0], PARKED)


def test_touchable_goals_are_saved_and_restored(spec):
    plant, other = (exact(1, spec=spec) for _ in range(2))
    tool, along, push = tool_and_push(plant, 0.008)
    goal = tool + (GOAL_RADIUS_M + 0.003) * along
    hold(plant, HOME + push, goal, 60)
    other.restore(plant.save())
    for each in (plant, other):
        hold(each, HOME + push, goal, 60)
    for name, array in plant.save().items():
        np.testing.assert_array_equal(other.save()[name], array, err_msg=name)
    assert plant.truth(0.0).allowed_contact_n[0, 0] > 5.0


def test_the_strongest_other_contact_is_found_among_allowed_ones(spec):
    """Random contacts, allowed or not, against a search through all of them."""
    rng, plant = np.random.default_rng(0), exact(500, spec=spec)
    places = plant.contacts.places
    expected = np.zeros(500)
    for robot in range(500):
        allowed, others = (rng.normal(size=(rng.integers(0, most), 3)) for most in (9, 4))
        both = np.concatenate((allowed, others))
        strongest = sorted(both.tolist(), key=np.linalg.norm, reverse=True)[: len(places.strongest)]
        pair = sorted(allowed.tolist(), key=np.linalg.norm, reverse=True)
        plant.sensed[robot] = 0.0
        for place, force in zip(places.strongest, strongest, strict=False):
            plant.sensed[robot, place] = force
        for place, force in zip(places.limited[0], pair, strict=False):
            plant.sensed[robot, place] = force
        if len(others):
            expected[robot] = max(others.tolist(), key=np.linalg.norm)[0]
    np.testing.assert_array_equal(plant.contacts.strongest_n, expected)


def pressed(spec):
    """Events by monitor, and the largest force, of an arm that presses its tool on the goal for two seconds."""
    contract = arm_contract(robot_digest=spec.digest, observation=(term("joint_position", 6),))
    draw = median_draw(load_distributions(spec), spec, 1).replaced(PLAIN)
    runtime, robot = simulate(spec, contract, [robot_seed(3, 0)], draw=draw)
    judge, largest = make_judge(spec, contract, 1), 0.0
    tool, along, push = tool_and_push(robot.plant, 0.006)
    robot.goal_source = lambda: (tool + (GOAL_RADIUS_M + 0.002) * along)[None]
    target = HOME + push
    for tick in range(round(2.5 / DT)):
        if tick == 40:
            assert not runtime.arm(np.ones(1, dtype=bool)).any()
        action = (
            np.clip((target - runtime.action.value) / 0.05, -0.01, 0.01) if tick > 60 else np.zeros((1, 6))
        )
        runtime.act(None if runtime.sense() is None else action)
        truth = robot.truth()
        judge_tick(judge, truth, runtime, action)
        largest = max(largest, float(truth.allowed_contact_n[0, 0]))
    counts = judge.counts()
    hard = {monitor.name: counts.total(monitor.name) for monitor in counts.monitors if monitor.hard}
    return {name: events for name, events in hard.items() if events}, largest


def test_force_below_its_limit_is_no_event_and_above_it_is_one(tmp_path):
    (events, force), (again, same) = (pressed(touching(tmp_path / str(n), n)) for n in (1000.0, 0.5))
    assert events == {}
    assert 5.0 < force == same
    assert again == {"allowed_contact_force": 1}
    below, above = (pressed(touching(tmp_path / name, limit))[0] for name, limit in _around(force))
    assert (below, above) == ({}, {"allowed_contact_force": 1})


BLOCK = (
    '<geom name="block" type="box" pos="-0.49 -0.13 0.2224" size="0.1 0.1 0.2224"/>\n    <geom name="table"'
)
"""Fixed to the table, 3 mm below the tool at home."""


def on_block(folder, pair):
    may = f"[[may_touch]]\nbodies = {pair}\n\n[sensors.encoder]"
    files = {"toml": [(r"\[sensors\.encoder\]", may)], "xml": [('<geom name="table"', BLOCK)]}
    return load_robot(copy_of_arm(folder, **files))


def test_a_tool_may_press_on_the_world_up_to_its_limit(tmp_path):
    limits, found = (1000.0, 0.5), []
    for limit in limits:
        pair = f'["wrist_3_link", "world"]\nforce_n = {limit}'
        found.append(pressed(on_block(tmp_path / str(limit), pair)))
    (events, force), (again, same) = found
    assert events == {}
    assert 5.0 < force == same
    assert again == {"allowed_contact_force": 1}


def test_another_link_on_the_world_is_a_collision(tmp_path):
    """Both in the plant and in the checks of the runtime."""
    spec, low = on_block(tmp_path, '["wrist_3_link", "world"]'), HOME.copy()
    plant = exact(1, spec=spec)
    _, _, push = tool_and_push(plant, 0.008)
    truth = hold(plant, HOME + push, HOME[:3], 200)
    assert set(forces_by_mujoco(plant)) == {frozenset(("block", "wrist_3"))}
    assert not truth.self_collision.any()
    low[1] += 0.9
    plant.reset(np.ones(1, dtype=bool), low[None])
    assert hold(plant, low, HOME[:3], 5).self_collision.all()
    poses = np.stack((HOME + push, low))
    assert Fleet(spec, 2, collisions=True).kinematics(poses).colliding.tolist() == [False, True]
    with pytest.raises(RobotError, match="there 'block' and 'wrist_3' are"):
        Fleet(on_block(tmp_path / "other", '["wrist_2_link", "world"]'), 1, collisions=True)


def _around(force):
    return ("more", 1.001 * force), ("less", 0.999 * force)


BAD = {
    "twice": ('["wrist_3_link", "wrist_3_link"]', "may_touch: found 'wrist_3_link' twice in a pair"),
    "no force": (
        '["wrist_3_link", "goal"]\nforce_n = 0.0',
        "force_n: Input should be greater than or equal to 0.000000000001, found 0",
    ),
    "no body": (
        '["world", "goal"]',
        "may_touch: found ['world', 'goal'], expected at least one body of the robot",
    ),
    "one": ('["wrist_3_link"]', "may_touch.0.bodies.1: Field required"),
    "pair twice": (
        '["base_link", "goal"]\n[[may_touch]]\nbodies = ["goal", "base_link"]',
        r"may_touch: found ['base_link', 'goal'] 2 times, expected each pair once",
    ),
}


@pytest.mark.parametrize(("bodies", "message"), BAD.values(), ids=BAD)
def test_a_bad_pair_is_refused(tmp_path, bodies, message):
    pair = f"[[may_touch]]\nbodies = {bodies}\n\n[sensors.encoder]"
    assert message in complaint(copy_of_arm(tmp_path, toml=[(r"\[sensors\.encoder\]", pair)]))


def test_an_unknown_body_is_refused_by_both_libraries(tmp_path):
    pair = '[[may_touch]]\nbodies = ["wrist_9", "goal"]\n\n[sensors.encoder]'
    robot = load_robot(copy_of_arm(tmp_path, toml=[(r"\[sensors\.encoder\]", pair)]))
    for load in (load_pinocchio, lambda spec: exact(1, spec=spec)):
        with pytest.raises(RobotError, match=r"may_touch: found 'wrist_9', expected a body of"):
            load(robot)


def test_a_robot_without_allowed_contacts_keeps_its_digest_and_capabilities(spec):
    assert "may_touch" not in SPEC.model_dump()
    assert spec.capabilities - SPEC.capabilities == {"allowed_contact"}


def test_a_part_of_the_model_that_is_called_like_the_goal_is_refused(tmp_path):
    spec = touching(tmp_path)
    text = spec.model_path.read_text()
    spec.model_path.write_text(text.replace('<geom name="table"', '<geom name="goal"', 1))
    with pytest.raises(RobotError, match=r"model\.xml: found a body or geom 'goal', expected none"):
        build(spec, load_distributions(spec).cable)
