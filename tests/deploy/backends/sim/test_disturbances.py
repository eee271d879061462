from itertools import pairwise

import numpy as np
import pytest

from support.deploy.plants import BUSY, DT, HOME, PLANT_MODEL, command, drawn, exact

mujoco = pytest.importorskip("mujoco")
disturbances = pytest.importorskip("deploy.backends.sim.disturbances")
plant_module = pytest.importorskip("deploy.backends.sim.plant")


def history(turns, ticks):
    """(ticks, B) when it was there; as `Plant.step` asks."""
    course = []
    for tick in range(ticks):
        turns.step(tick)
        course.append(turns.on.copy())
    return np.array(course)


def lengths(course, value):
    """Ticks of every whole run of `value` in (ticks,)."""
    edges = np.flatnonzero(np.diff(course.astype(int))) + 1
    return [b - a for a, b in pairwise(edges) if course[a] == value]


def test_payloads_come_and_go_as_drawn():
    """Carried and free for as long as drawn, to the tick, and each robot somewhere else in its cycle at first."""
    plant = drawn(40, {"payload.carried_s": 0.35, "payload.free_s": 0.2})
    at_first = plant.disturbances["payload"].on.copy()
    course = history(plant.disturbances["payload"], 500)
    for robot in range(40):
        assert set(lengths(course[:, robot], True)) == {70}
        assert set(lengths(course[:, robot], False)) == {40}
    assert 15 < at_first.sum() < 35  # 35 of 55 of 40 on the average
    np.testing.assert_array_equal(course[0], at_first)
    starts = [np.flatnonzero(np.diff(course[:, robot].astype(int)))[0] for robot in range(40)]
    assert len(set(starts)) > 20


def test_a_payload_is_a_ball_of_aluminium_where_the_draw_says():
    com = np.array([0.02, -0.01, 0.03])
    plant = drawn(4, BUSY | {"payload.mass_kg": 0.8, "payload.com_m": com})
    for tick in range(300):
        plant.disturbances["payload"].step(tick)
        for i in range(4):
            own, on = plant.batch.get_model(i), bool(plant.disturbances["payload"].on[i])
            body = own.body("firstshift/payload")
            assert body.mass[0] == (0.8 if on else 0.0)
            radius = (0.8 / (4 / 3 * np.pi * 2700.0)) ** (1 / 3)
            np.testing.assert_allclose(body.inertia, on * 0.4 * 0.8 * radius**2 * np.ones(3))
            np.testing.assert_array_equal(body.ipos, com)
            np.testing.assert_allclose(body.pos, own.site("tool").pos)
            bodies = own.body_mass[: PLANT_MODEL.payload + 1]
            assert own.body_subtreemass[1] == pytest.approx(bodies.sum(), rel=1e-12)


def test_a_changed_tool_is_a_second_ball_whether_or_not_a_payload_is_carried():
    plant = drawn(2, BUSY | {"payload.mass_kg": 0.8})
    payload = plant.disturbances["payload"]
    for tick in range(300):
        payload.step(tick)
        if tick in {50, 250}:
            payload.change_tool(0, 1.5 if tick == 50 else 0.0)
        mass = plant.batch.expand("body_mass")[:, PLANT_MODEL.payload]
        heavier = np.array([1.5 if 50 <= tick < 250 else 0.0, 0.0])
        np.testing.assert_allclose(mass, 0.8 * payload.on + heavier)
    assert plant.batch.expand("body_inertia")[0, PLANT_MODEL.payload].max() < 0.002


def test_a_changed_tool_is_saved():
    one, other = drawn(1), drawn(1)
    one.disturbances["payload"].change_tool(0, 1.5)
    other.restore(one.save())
    mass = [plant.batch.expand("body_mass")[0, PLANT_MODEL.payload] for plant in (one, other)]
    assert mass[0] == mass[1] >= 1.5


def test_payload_loads_every_joint():
    """Statics: the moments of its weight."""
    loaded, free = (
        exact(
            1,
            {"payload.mass_kg": mass, "payload.carried_s": 1e6, "payload.free_s": 0.1, "payload.com_m": 0.0},
        )
        for mass in (2.0, 0.0)
    )
    assert loaded.disturbances["payload"].on[0]
    forces = []
    for plant in (loaded, free):
        model, data = plant.batch.get_model(0), plant.batch.get_data(0)
        mujoco.mj_forward(model, data)
        forces.append(data.qfrc_bias.copy())
    jacobian = np.zeros((3, model.nv))
    mujoco.mj_jacSite(model, data, jacobian, None, PLANT_MODEL.tool)
    np.testing.assert_allclose(forces[0] - forces[1], jacobian.T @ [0.0, 0.0, 2.0 * 9.81], atol=1e-9)


@pytest.mark.slow
def test_pushes_last_as_drawn_after_exponential_pauses():
    plant = drawn(200, {"push.every_s": 2.0, "push.lasts_s": 0.1})
    course = history(plant.disturbances["pushes"], 8000)
    assert not course[0].any()
    assert {n for robot in range(200) for n in lengths(course[:, robot], True)} == {20}
    pauses = DT * np.array([n for robot in range(200) for n in lengths(course[:, robot], False)])
    assert len(pauses) > 3000
    assert pauses.mean() == pytest.approx(2.0, rel=0.12)  # whole pauses inside 40 s are a little short
    assert pauses.std() == pytest.approx(pauses.mean(), rel=0.12)
    assert pauses.min() < 0.05


def test_pushes_come_from_everywhere_on_every_moving_link():
    plant = drawn(100, {"push.every_s": 1.0, "push.lasts_s": 0.1, "push.force_n": 17.0})
    applied, seen = plant.batch.bind("xfrc_applied"), []
    for tick in range(2000):
        plant.disturbances["pushes"].step(tick)
        on = plant.disturbances["pushes"].on
        assert not applied[~on].any()
        if tick % 25 == 0:
            seen.append(applied[on].copy())
    forces = np.concatenate(seen)
    assert not forces[:, :, 3:].any()
    assert (np.count_nonzero(forces.any(axis=2), axis=1) == 1).all()
    one = forces.sum(axis=1)[:, :3]
    np.testing.assert_allclose(np.linalg.norm(one, axis=1), 17.0)
    assert np.linalg.norm(one.mean(axis=0)) < 17.0 * 0.15
    np.testing.assert_allclose((one**2).mean(axis=0), 17.0**2 / 3, rtol=0.2)
    links = np.argmax(forces.any(axis=2), axis=1)
    assert set(links) == set(PLANT_MODEL.bodies)


def test_a_push_is_felt_while_it_lasts():
    plant = exact(1, {"push.every_s": 1.0, "push.lasts_s": 0.2, "push.force_n": 300.0})
    moved = {True: 0.0, False: 0.0}
    rest = plant.q[0].copy()
    for tick in range(1000):
        plant.step(command(HOME))
        on = bool(plant.disturbances["pushes"].on[0])
        moved[on] = (
            max(moved[on], np.abs(plant.q[0] - rest).max())
            if on or tick < plant.disturbances["pushes"].until[0]
            else 0
        )
    assert plant.disturbances["pushes"].phase[0] > 3
    assert moved[True] > 1e-3


def test_a_reset_does_not_end_a_push():
    plant = exact(1, {"push.every_s": 1.0, "push.lasts_s": 1.0, "push.force_n": 30.0})
    while not plant.disturbances["pushes"].on[0]:
        plant.step(command(HOME))
    before = plant.batch.bind("xfrc_applied").copy()
    plant.reset(np.ones(1, dtype=bool), HOME[None])
    assert before.any()
    np.testing.assert_array_equal(plant.batch.bind("xfrc_applied"), before)


def test_disturbances_depend_on_the_seed_and_not_on_the_group():
    many, alone = drawn(5, BUSY), drawn(5, BUSY, rows=slice(3, 4))
    for name in ("payload", "pushes"):
        courses = [history(plant.disturbances[name], 600) for plant in (many, alone)]
        np.testing.assert_array_equal(courses[0][:, 3:4], courses[1])
        assert (courses[0] != courses[0][:, :1]).any()
    assert disturbances.Payload.stream != disturbances.Pushes.stream


def test_tick_without_a_change_writes_nothing(monkeypatch):
    plant, done = drawn(3), []
    monkeypatch.setattr(disturbances.Intermittent, "_extend", lambda *_: done.append(1))
    for tick in range(100):
        plant.disturbances["pushes"].step(tick)
        plant.disturbances["payload"].step(tick)
    assert not done
    assert min(plant.disturbances["pushes"].until.min(), plant.disturbances["payload"].until.min()) > 100


class Lift(disturbances.Intermittent):
    """The base is lifted by 1 N for every other tick."""

    name, stream, carried = "lift", 99, (*disturbances.Intermittent.carried, "force")

    def __init__(self, batch, plant, draw, seeds, dt):
        self.force, self._batch = np.zeros(len(seeds)), batch
        super().__init__(batch, plant, draw, seeds, dt)

    def seconds(self, robot):
        return DT

    def apply(self, rows):
        self.force[rows] = self.on[rows]


def test_another_disturbance_is_one_class(monkeypatch):
    monkeypatch.setattr(plant_module, "DISTURBANCES", (*disturbances.DISTURBANCES, Lift))
    plant, seen = drawn(2), []
    for _ in range(4):
        plant.step(command(np.tile(HOME, (2, 1))))
        seen.append(plant.disturbances["lift"].force.tolist())
    assert seen == [[0.0, 0.0], [1.0, 1.0]] * 2
    np.testing.assert_array_equal(plant.save()["lift.force"], [1.0, 1.0])
