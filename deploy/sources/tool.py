"""Observation sources of a tool, and of the force sensor behind it."""

from collections.abc import Mapping

from deploy.sources import maximum
from deploy.sources.readings import sensor_reading
from deploy.sources.source import ObservationSource

TOOL_SOURCES: Mapping[str, ObservationSource] = {
    "tool_position": ObservationSource(
        frame="world",
        unit="m",
        size=3,
        sensing="proprioceptive",
        maximum=maximum.REACH,
        read=lambda runtime: runtime.tool.position,
        meaning="tool: encoder and nominal kinematics",
        needs=frozenset({"tool"}),
    ),
    "tool_force": ObservationSource(
        frame="sensor",
        unit="N",
        size=3,
        sensing="exteroceptive",
        maximum=maximum.sensor_range("force"),
        read=lambda runtime: sensor_reading(runtime, "force"),
        meaning="force with which the link before holds the sensor's link: against its weight, its load and what it"
        " touches; 0 without reading",
        sensors=("force",),
    ),
    "tool_torque": ObservationSource(
        frame="sensor",
        unit="N·m",
        size=3,
        sensing="exteroceptive",
        maximum=maximum.sensor_range("torque"),
        read=lambda runtime: sensor_reading(runtime, "torque"),
        meaning="torque that belongs to tool_force, about the sensor; 0 without reading",
        sensors=("torque",),
    ),
}
