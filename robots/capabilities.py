"""Capabilities: what a robot may have beside joints, each optional on its own.

Safety checks, monitors, observation sources and log columns name the capabilities that they need; a robot gets those
whose needs it meets. Nothing else asks what kind of robot it is.
"""

from typing import Literal

Capability = Literal["tool", "workspace", "manipulability", "floating_base", "self_collision"]
"""tool: a site or body with a pose of its own. workspace: bounds on the tool's position and speed. manipulability: a
least distance from singularities. floating_base: the robot stands on feet. self_collision: shapes kept apart."""
