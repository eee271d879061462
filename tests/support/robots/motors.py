from robots.motors.motor import MotorHeat
from support.arm6 import copy_of_arm

DRIVES = {
    "size3": """[motors.size3.drive]
gear = 101.0
torque_constant = 0.1
resistance_ohm = 0.5
reference_c = 25.0
copper_per_k = 0.0039
winding_resistance_k_per_w = 1.0
winding_capacity_j_per_k = 40.0
supply_v = 48.0
kp = 40804.0
kd = 652.864

""",
    "size1": """[motors.size1.drive]
gear = 101.0
torque_constant = 0.1
resistance_ohm = 3.0
reference_c = 25.0
copper_per_k = 0.0039
winding_resistance_k_per_w = 2.0
winding_capacity_j_per_k = 12.0
supply_v = 48.0
kp = 4080.4
kd = 122.412

""",
}
"""What model.xml of the arm says of its drives, in robot.toml's words."""
VENDOR = [("(?s)<actuator>.*?</actuator>", ""), (r"(?s)<dcmotor.*?/>", ""), (r"(?s)<dcmotor.*?/>", "")]
"""Takes the drives out of the arm's model."""


def declared(folder, drives=DRIVES, *, xml=VENDOR):
    """The arm with its drives in robot.toml."""
    folder = copy_of_arm(folder, xml=xml)
    path = folder / "robot.toml"
    path.write_text(path.read_text().replace("[[joints]]", "".join(drives.values()) + "[[joints]]", 1))
    return folder


RE40 = MotorHeat(
    resistance=1.16,
    alpha=0.0039,
    reference_c=25.0,
    winding_to_housing=1.93,
    housing_to_ambient=4.65,
    winding_capacity=41.6 / 1.93,
    housing_capacity=1120.0 / 4.65,
)
