"""Observation sources of robots, whatever their task; a task declares its own."""

from collections.abc import Mapping

from deploy.sources.floating_base import BASE_SOURCES
from deploy.sources.joints import JOINT_SOURCES
from deploy.sources.source import ObservationSource
from deploy.sources.tool import TOOL_SOURCES

SOURCES: Mapping[str, ObservationSource] = {**JOINT_SOURCES, **TOOL_SOURCES, **BASE_SOURCES}
