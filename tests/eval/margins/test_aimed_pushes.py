"""Pushes along the motion: when, where and in which direction."""

from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("mujoco")

from eval.margins.aimed_pushes import NEAR, NOBODY, PAUSE_S, AimedPushes, Aims, Moment
from robots.spec import load_robot

SPEC = load_robot("planar3")
PAUSE, LASTS, FORCE = round(PAUSE_S / SPEC.dt), 4, 5.0
AIMS = Aims(np.array([0, 1, 2, NOBODY]), np.array([1, 2, 2, 0]), np.full(4, Moment.FAST))
"""Robots of the bench: pushed along the motion of shoulder, elbow and wrist, and never."""


class Bench:
    """Four robots at q = 0, along x. Positive speeds move them up, along z."""

    def __init__(self, spec=SPEC, aims=AIMS, centre=(0.0, 0.0, 0.0)):
        robots = len(aims.joints)
        self.shape = robots, spec.n
        self.forces = np.zeros((robots, 1 + spec.n, 6))
        batch = SimpleNamespace(bind=lambda name: {"xfrc_applied": self.forces}[name])
        plant = SimpleNamespace(batch=batch, bodies=1 + np.arange(spec.n))
        draw = {f"push.{k}": np.full(robots, x) for k, x in (("force_n", FORCE), ("lasts_s", 4.2 * spec.dt))}
        draw["links.com_m"] = np.broadcast_to(centre, (*self.shape, 3))
        self.pushes = AimedPushes(spec, plant, draw, aims)

    def step(self, speed, qd, ticks=1, *, stops=False, **more):
        """Step with one planned share of all joints, true speeds and stops; return forces (B, 3)."""
        planned = {"speed": np.full(self.shape, speed)} | more
        for _ in range(ticks):
            self.pushes.step(
                planned,
                np.zeros(self.shape),
                np.broadcast_to(qd, self.shape),
                np.broadcast_to(stops, self.shape[0]),
            )
        return self.forces[:, :, :3].sum(axis=1)


def test_a_push_begins_after_a_pause_along_the_motion_and_ends():
    bench = Bench()
    assert not bench.step(0.5, 1.0, PAUSE).any()
    up = np.array([[0.0, 0.0, FORCE]] * 3 + [[0.0, 0.0, 0.0]])
    np.testing.assert_allclose(bench.step(0.5, [1.0, 0.5, 0.1]), up, atol=1e-12)
    assert bench.pushes.on.tolist() == [True, True, True, False]
    np.testing.assert_allclose(bench.step(0.5, -1.0, LASTS - 1), up, atol=1e-12)  # it keeps its direction
    assert not bench.step(0.5, -1.0).any()
    assert not bench.pushes.on.any()
    assert not bench.step(0.5, -1.0, PAUSE - 1).any()
    np.testing.assert_allclose(bench.step(0.5, -1.0), -up, atol=1e-12)


def test_a_push_waits_until_the_joint_is_as_fast_as_it_was():
    bench = Bench()
    bench.step(0.8, 1.0)
    assert not bench.step(0.99 * NEAR * 0.8, 1.0, PAUSE + 20).any()
    assert bench.step(1.01 * NEAR * 0.8, 1.0)[:3].any(axis=1).all()


def test_a_robot_that_never_moved_is_not_pushed():
    assert not Bench().step(0.0, 0.0, PAUSE + 5).any()


def test_links_of_the_aims_are_pushed():
    bench = Bench()
    bench.step(0.5, 1.0, PAUSE + 1)
    pushed = bench.forces[:3, 1:, :3].any(axis=2)
    np.testing.assert_array_equal(pushed, AIMS.links[:3, None] == np.arange(SPEC.n))


def test_a_push_on_a_joint_that_brakes_waits_until_its_speed_falls():
    moments = np.array([Moment.BRAKING, Moment.FAST, Moment.FAST, Moment.BRAKING])
    bench = Bench(aims=AIMS._replace(moments=moments))
    bench.step(0.5, 1.0, PAUSE + 2)
    assert bench.pushes.on.tolist() == [False, True, True, False]
    bench.step(0.499, 1.0)
    assert bench.pushes.on.tolist() == [True, True, True, False]


def test_a_push_as_a_stop_begins_waits_for_one_from_a_high_speed():
    moments = np.array([Moment.STOPPING, Moment.STOPPING, Moment.FAST, Moment.STOPPING])
    bench = Bench(aims=AIMS._replace(moments=moments))
    bench.step(0.5, 1.0, PAUSE + 2)
    assert bench.pushes.on.tolist() == [False, False, True, False]
    bench.step(0.99 * NEAR * 0.5, 1.0, stops=True)
    assert bench.pushes.on.tolist() == [False, False, True, False]
    bench.step(0.5, 1.0, stops=np.array([True, False, True, True]))
    assert bench.pushes.on.tolist() == [True, False, True, False]


def test_the_tool_is_pushed_along_its_own_motion_by_its_own_speed():
    spec = load_robot("arm6")
    bench = Bench(spec, Aims(np.array([spec.n]), np.array([spec.n - 1]), np.array([Moment.FAST])))
    assert not bench.step(0.7, 0.0, PAUSE + 5, tool_speed=np.zeros((1, 1))).any()
    force = bench.step(0.0, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0], tool_speed=np.full((1, 1), 0.3))
    assert bench.forces[0, spec.n, :3] @ bench.forces[0, spec.n, :3] == pytest.approx(FORCE**2)
    assert abs(force[0, 2]) < 1e-9  # the base turns about a vertical axis


def test_a_link_is_pushed_where_its_drawn_centre_of_mass_goes():
    """That of the nominal last wrist lies on its axis, and does not move."""
    spec = load_robot("arm6")
    forces = [
        Bench(spec, Aims(*np.array([[5], [5], [0]])), centre).step(0.5, 1.0, PAUSE + 1)[0]
        for centre in ((0.0, 0.0, 0.0), (0.01, 0.0, 0.0), (-0.01, 0.0, 0.0))
    ]
    assert np.linalg.norm(forces, axis=1) == pytest.approx([0.0, FORCE, FORCE], abs=1e-6)
    np.testing.assert_allclose(forces[1], -forces[2], atol=1e-9)
