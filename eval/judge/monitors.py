"""Catalogue of all monitors. To add one, declare it in joint_monitors.py, command_monitors.py or robot_monitors.py."""

from eval.judge.command_monitors import COMMAND_MONITORS
from eval.judge.joint_monitors import JOINT_MONITORS
from eval.judge.monitor import Monitor
from eval.judge.robot_monitors import ROBOT_MONITORS

MONITORS: tuple[Monitor, ...] = (*JOINT_MONITORS, *COMMAND_MONITORS, *ROBOT_MONITORS)
NAMES = tuple(monitor.name for monitor in MONITORS)
