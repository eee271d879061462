"""The judge's own limits of a robot: the shipped ones, and every way of misspelling them."""

import pytest

from eval.judge.limits import load_limits
from robots.errors import ConfigError
from robots.spec import load_robot
from support.arm6 import copy_of_arm

SPEC = load_robot("arm6")
LIMITS_TEXT = (SPEC.folder / "limits.toml").read_text()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("power_w", "power", "power: Extra inputs"),
        ("contact_n = 140.0", "contact_n = 0.0", r"contact_n: .* found 0\.0"),
        ("nees = 64.0", "nees = 5e-324", r"nees: .* found 5e-324"),
        ("power_w = 300.0", "power_w = 1e300", r"power_w: .* 1000000000, found 1e\+300"),
        ("nees = 64.0", "", "nees: Field required"),
        ("manipulability = 0.00025", "manipulability = -1.0", r"manipulability: .* found -1\.0"),
        ("manipulability = 0.00025", "", "manipulability: found none, expected one"),
        ("[motors.size3]", "[motors.size9]", "motors: found size1, size9, expected size1, size3"),
    ],
)
def test_wrong_limits_name_file_and_field(tmp_path, old, new, message):
    folder = copy_of_arm(tmp_path)
    (folder / "limits.toml").write_text(LIMITS_TEXT.replace(old, new, 1))
    with pytest.raises(ConfigError, match=message) as caught:
        load_limits(load_robot(folder))
    assert str(folder / "limits.toml") in str(caught.value)


def test_a_robot_without_limits(tmp_path):
    folder = copy_of_arm(tmp_path)
    (folder / "limits.toml").unlink()
    with pytest.raises(ConfigError, match=r"limits\.toml: cannot be read"):
        load_limits(load_robot(folder))


def test_limits_belong_to_motors_and_are_not_part_of_the_robot_digest(tmp_path):
    folder = copy_of_arm(tmp_path)
    limits = load_limits(SPEC)
    assert limits.motor_array("power_w", SPEC).tolist() == [240.0] * 3 + [40.0] * 3
    (folder / "limits.toml").write_text(LIMITS_TEXT.replace("power_w = 40.0", "power_w = 41.0"))
    other = load_robot(folder)
    assert (load_limits(other).digest != limits.digest, other.digest) == (True, SPEC.digest)
