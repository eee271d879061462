"""Heat of simulated motors against closed forms."""

from dataclasses import replace

import numpy as np
import pytest

from robots.motors.motor import temperatures
from robots.spec import load_robot
from support.arm6 import copy_of_arm
from support.deploy.plants import HOME, N, command, exact
from support.robots.motors import RE40

pytest.importorskip("mujoco")


def re40_arm(tmp_path, hz):
    """The arm with an RE40-like motor on its last joint: facts as in test_motor; 48 V, gear 101."""
    folder = copy_of_arm(
        tmp_path,
        toml=[
            *[("rate_hz = (200|30)", "rate_hz = 10")] * 4,
            ("stale_s = 0.035", "stale_s = 0.2"),
            ("lost_s = 0.110", "lost_s = 0.5"),
            ("control_hz = 200", f"control_hz = {hz}"),
            ("physics_hz = 1000", f"physics_hz = {hz}"),
            ("housing_resistance_k_per_w = 7.0", f"housing_resistance_k_per_w = {RE40.housing_to_ambient}"),
            ("housing_capacity_j_per_k = 400.0", f"housing_capacity_j_per_k = {RE40.housing_capacity}"),
        ],
        xml=[
            (
                r'motorconst="0.1 0.1" resistance="3.0" saturation="0.27722772277227725"',
                'motorconst="0.0603 0.0603" resistance="1.16" saturation="9"',
            ),
            (r'thermal="2.0 12 0 0.0039 25 25"', f'thermal="1.93 {RE40.winding_capacity} 0 0.0039 25 25"'),
            # The joint is too heavy to turn, and the drive does next to nothing but what it is told.
            (r'armature="0.20402"', 'armature="1e9"'),
            (r'controller="0.4 0 0.012 0 0 48"', 'controller="1e-9 0 0 0 0 480"'),
            (r'actuatorfrcrange="-28 28"', 'actuatorfrcrange="-900 900"'),
        ],
    )
    return load_robot(folder)


def as_drawn(winding_to_housing=1.0, winding_capacity=1.0, housing_to_ambient=1.0, housing_capacity=1.0):
    """The motor, and the draw, of which these are the factors."""
    factors = dict(locals())
    motor = replace(RE40, **{name: factor * getattr(RE40, name) for name, factor in factors.items()})
    return motor, {f"drives.{name}": factor for name, factor in factors.items()}


@pytest.mark.parametrize(
    ("minutes", "hz", "factors"),
    [(1, 200, ()), (1, 50, (1.2, 0.8, 0.8, 1.2)), (8, 20, (0.8, 1.2, 1.2, 0.8))],
)
@pytest.mark.slow
def test_heat_follows_the_closed_form_within_1_k(tmp_path, minutes, hz, factors):
    """Two nodes, one in MuJoCo and one beside it, and R(T): a locked joint at a constant 3.12 A."""
    motor, changes = as_drawn(*factors)
    spec, ambient = re40_arm(tmp_path, hz), 25.0
    plant, dt = exact(1, changes, spec=spec), spec.dt
    tau = np.zeros(N)
    for k in range(round(minutes * 60 / dt)):
        plant.step(command(HOME, tau=tau, spec=spec))
        # A commanded torque sags as the winding warms: the current is held from outside.
        if k % 20 == 0:
            measured = plant.current[0, 5]
            tau[5] = 3.12 * 0.0603 * 101 if k == 0 else tau[5] * 3.12 / measured
    assert plant.current[0, 5] == pytest.approx(3.12, rel=0.01)
    winding, housing = temperatures(motor, 3.12, ambient, minutes * 60)
    truth = plant.truth(0.0)
    assert truth.winding_c[0, 5] == pytest.approx(winding, abs=1.0)
    assert truth.housing_c[0, 5] == pytest.approx(housing, abs=1.0)
    assert truth.winding_c[0, 4] == pytest.approx(ambient, abs=0.5)


@pytest.mark.parametrize("modes", [("position", "velocity", "torque"), ("position", "velocity")])
def test_a_commanded_torque_sags_as_the_winding_heats_if_no_loop_holds_its_current(modes, tmp_path):
    """Such a drive takes its winding for cold: of the current it asks for, it gets R0 / R(T)."""
    spec = re40_arm(tmp_path, 50)
    motors = {name: motor.model_copy(update={"modes": modes}) for name, motor in spec.motors.items()}
    spec = spec.model_copy(update={"motors": motors})
    plant, tau = exact(spec=spec), np.zeros(N)
    tau[5] = 4.0 * 0.0603 * 101
    for _ in range(60 * 50):
        plant.step(command(HOME, tau=tau, spec=spec))
    warmer = plant.truth(0.0).winding_c[0, 5] - 25.0
    assert warmer > 20.0
    hot = 1.0 if "torque" in modes else 1.0 + 0.0039 * warmer
    assert plant.current[0, 5] == pytest.approx(4.0 / hot, rel=1e-3)
