"""File of winding temperatures that survives a restart: minutes after a power loss a hot winding is still warm."""

import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Annotated, Self

import numpy as np
from pydantic import Field, model_validator

from deploy.estimation.winding_observer import WindingObserver
from deploy.telemetry.output_files import replacing
from robots.arrays import Floats
from robots.errors import ConfigError
from robots.files import is_missing
from robots.spec import RobotSpec
from robots.strict import Strict, parse, read_json_file

PERIOD_S = 5.0
"""s between two writes: windings have time constants of tens of seconds."""

RISE_K = (-10.0, 500.0)
"""K, credible range of a rise: a winding is at most as much colder than its housing as the sensor of that may err."""

CHARACTERS_MAX = 1 << 16


class Temperatures(Strict):
    """Contents of the file.

    Attributes:
        robot: its name. joints: their names, in the order of the numbers.
        unix_s: s since 1970. rise_k: K, each winding above its housing at that time.
    """

    robot: str
    joints: tuple[str, ...]
    unix_s: Annotated[float, Field(ge=0)]
    rise_k: tuple[Annotated[float, Field(ge=RISE_K[0], le=RISE_K[1])], ...]

    @model_validator(mode="after")
    def _one_rise_per_joint(self) -> Self:
        if len(self.rise_k) != len(self.joints):
            raise ValueError(f"rise_k holds {len(self.rise_k)} numbers for {len(self.joints)} joints")
        return self


class TemperatureFile:
    """Winding temperatures of robot 0, written every few seconds by a separate thread: no disk delays a tick.

    Attributes:
        error: message of the last write if it failed, or None; the robot goes on.
    """

    def __init__(
        self,
        path: Path,
        spec: RobotSpec,
        windings: WindingObserver,
        *,
        same_robot: bool = True,
        now: Callable[[], float] = time.time,
    ) -> None:
        """Read the file, if there is one, and start the observer from it before the first tick.

        Contents about another robot than will run, not `same_robot`, are replaced. `now` is a clock, s since 1970.

        Raises:
            ConfigError: the file has other contents, or is about a robot of another name or with other joints.
        """
        self._path, self._windings, self._now = path, windings, now
        self._robot, self._joints = spec.name, spec.joint_names
        self.error: str | None = None
        previous = self._read() if same_robot else None
        if previous:
            self._windings.resume(np.array([previous.rise_k]), max(0.0, now() - previous.unix_s))
        self._write(previous or self._temperatures(np.zeros(spec.n)))
        self._pool = ThreadPoolExecutor(max_workers=1)
        self._writing: Future[None] | None = None

    def _read(self) -> Temperatures | None:
        source = f"--out {self._path}"
        if is_missing(self._path):
            return None
        previous = parse(read_json_file(self._path, CHARACTERS_MAX, source), Temperatures, source=source)
        for name, expected in (("robot", self._robot), ("joints", self._joints)):
            found = getattr(previous, name)
            if found != expected:
                remedy = "each robot needs an --out of its own"
                raise ConfigError(f"{source}: {name}: found {found!r}, expected {expected!r}: {remedy}")
        return previous

    def _temperatures(self, rise: Floats) -> Temperatures:
        rise_k = tuple(np.clip(rise, *RISE_K).round(2).tolist())
        return Temperatures(robot=self._robot, joints=self._joints, unix_s=self._now(), rise_k=rise_k)

    def _write(self, temperatures: Temperatures) -> None:
        with replacing(self._path) as partial:
            partial.write_text(temperatures.model_dump_json(indent=2) + "\n", encoding="utf-8")

    def save(self, _: object = None) -> None:
        """Start to write the present temperatures, unless they are unknown or the last write has not ended."""
        if self._writing is None or self._writing.done():
            self._check_write()
            rise = self._windings.winding[0] - self._windings.housing[0]
            if np.isfinite(rise).all():
                self._writing = self._pool.submit(self._write, self._temperatures(rise))

    def close(self) -> None:
        """Write for the last time and wait for it."""
        self._check_write()
        self.save()
        self._pool.shutdown()
        self._check_write()

    def _check_write(self) -> None:
        error = self._writing.exception() if self._writing else None
        self.error = None if error is None else f"motor temperatures {error}"
