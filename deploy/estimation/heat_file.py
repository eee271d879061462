"""Temperatures that survive the runtime: a winding that was hot when the power went is still warm minutes later."""

import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Annotated, Self

import numpy as np
from pydantic import Field, model_validator

from deploy.runtime import Runtime
from deploy.telemetry.output_files import replacing
from robots.arrays import Floats
from robots.errors import ConfigError
from robots.strict import Strict, parse, read_json

PERIOD_S = 5.0
"""s between two writings: windings have time constants of tens of seconds."""

RISE_K = (-200.0, 500.0)
"""K. Beyond this no winding is: a sensor was wrong."""

CHARACTERS_MAX = 1 << 16


class Temperatures(Strict):
    """What the file holds.

    Attributes:
        robot: its name. joints: names in the order of the numbers.
        unix_s: s since 1970, when it was so. rise_k: K, each winding above its housing.
    """

    robot: str
    joints: tuple[str, ...]
    unix_s: Annotated[float, Field(ge=0)]
    rise_k: tuple[Annotated[float, Field(ge=RISE_K[0], le=RISE_K[1])], ...]

    @model_validator(mode="after")
    def _one_each(self) -> Self:
        if len(self.rise_k) != len(self.joints):
            raise ValueError(f"rise_k holds {len(self.rise_k)} numbers for {len(self.joints)} joints")
        return self


class HeatFile:
    """Robot 0's temperatures, written every few seconds by a thread of their own: no disk holds up a tick.

    Attributes:
        lost: what went wrong with the disk, in words; the robot goes on.
    """

    def __init__(
        self, path: Path, runtime: Runtime, *, same: bool = True, now: Callable[[], float] = time.time
    ) -> None:
        """Hand what the file holds to the runtime.

        Args:
            path: the file; none yet is no error.
            runtime: not armed yet.
            same: whether the file is about the robot that will run; what it holds of another is replaced.
            now: s since 1970.

        Raises:
            ConfigError: the file is not what this writes, or of another robot.
            OutputError: it cannot be written.
        """
        self._path, self._heat, self._now = path, runtime.estimator.heat, now
        self._robot, self._joints = runtime.spec.name, runtime.spec.joint_names
        self.lost: str | None = None
        former = self._read() if same else None
        if former:
            self._heat.resume(np.array([former.rise_k]), max(0.0, now() - former.unix_s))
        self._write(former or self._temperatures(np.zeros(runtime.spec.n)))
        self._pool = ThreadPoolExecutor(max_workers=1)
        self._writing: Future[None] | None = None

    def _read(self) -> Temperatures | None:
        try:
            text = self._path.read_text(encoding="utf-8")
        except FileNotFoundError:
            return None
        except (OSError, UnicodeDecodeError) as e:
            raise ConfigError(f"--out {self._path}: cannot be read: {e}") from e
        source = f"--out {self._path}"
        former = parse(read_json(text, source, CHARACTERS_MAX), Temperatures, source=source)
        for name, expected in (("robot", self._robot), ("joints", self._joints)):
            found = getattr(former, name)
            if found != expected:
                raise ConfigError(f"{source}: {name}: found {found!r}, expected {expected!r}")
        return former

    def _temperatures(self, rise: Floats) -> Temperatures:
        rise_k = tuple(np.clip(rise, *RISE_K).round(2).tolist())
        return Temperatures(robot=self._robot, joints=self._joints, unix_s=self._now(), rise_k=rise_k)

    def _write(self, temperatures: Temperatures) -> None:
        with replacing(self._path) as partial:
            partial.write_text(temperatures.model_dump_json(indent=2) + "\n", encoding="utf-8")

    def offer(self, _: object = None) -> None:
        """Write what is believed now, unless the last writing still waits for its disk."""
        if self._writing is None or self._writing.done():
            self._listen()
            rise = self._heat.winding[0] - self._heat.housing[0]
            if np.isfinite(rise).all():
                self._writing = self._pool.submit(self._write, self._temperatures(rise))

    def close(self) -> None:
        """Write for the last time."""
        self._listen()
        self.offer()
        self._pool.shutdown()
        self._listen()

    def _listen(self) -> None:
        error = self._writing.exception() if self._writing else None
        if error:
            self.lost = str(error)
