"""deploy-check: move each joint of a robot by itself, and compare what it does with robot.toml and the model."""

from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from deploy.command_line import BUDGET_EXCEEDED, PASSED, main
from deploy.commissioning.bounds import Bounds
from deploy.commissioning.evaluation import Evaluation
from deploy.commissioning.moves import CheckMoves
from deploy.commissioning.report import show, write_report
from deploy.operation.interrupts import Interrupts, handled
from deploy.operation.jog import Jog, reduced_speed
from deploy.operation.robot_run import Ending
from deploy.operation.session import (
    BackendName,
    DrawName,
    Drive,
    Options,
    Out,
    RobotName,
    Seed,
    Session,
    Speed,
    ViewFlag,
)
from deploy.start import INTERRUPTED
from robots.errors import ConfigError
from robots.spec import RobotSpec, load_robot

ANGLE_DEG = (2.0, 15.0)
"""Least and largest --angle-deg: less than the least is lost in noise and play."""
RUN_S = 1200.0
"""s after which a check ends in any case."""

Angle = Annotated[
    float,
    typer.Option(help=f"degrees by which each joint moves, either way, {ANGLE_DEG[0]:g} to {ANGLE_DEG[1]:g}"),
]


def check(
    robot: RobotName = "arm6",
    backend: BackendName = "sim",
    angle_deg: Angle = 5.0,
    speed: Speed = "1",
    seed: Seed = None,
    draw: DrawName = None,
    out: Out = Path("out/check"),
    view: ViewFlag = False,
) -> int:
    """Commission a robot: order, sign, scale, delay, friction, gravity and tracking of each joint.

    The robot moves from where it stands, slowly, within all checks of a run. A robot with a floating base hangs
    from its gantry and is jogged instead. Exit codes: 0 passed, 1 a joint failed or a file could not be
    kept, 2 bad input and nothing moved, 70 internal error, 130 interrupted.
    """
    spec = load_robot(robot)
    if not ANGLE_DEG[0] <= angle_deg <= ANGLE_DEG[1]:
        raise ConfigError(
            f"--angle-deg {angle_deg:g}: expected degrees from {ANGLE_DEG[0]:g} to {ANGLE_DEG[1]:g}"
        )
    _check_fixed(spec)
    options = Options(
        spec=spec, backend=backend, duration=RUN_S, speed=speed, seed=seed, draw=draw, out=out, view=view
    )
    interrupts = Interrupts()
    session, bounds, slow = Session(options, interrupts), Bounds(spec), reduced_speed(spec)
    actor = Jog(slow)
    moves = CheckMoves(actor, slow, float(np.deg2rad(angle_deg)))
    with ExitStack() as printing_last, ExitStack() as printing, handled(interrupts):
        found = out / "check.json"
        drive = Drive(name="check", actor=actor, spec=slow, outputs=[found], watchers=[moves])
        run = session.run(drive, printing)
        refused = run.reason if run.ending is Ending.REFUSED else ""
        findings = Evaluation(spec, moves, bounds, refused).findings
        if run.ending is not Ending.DONE:
            findings.stopped = findings.stopped or run.reason or (run.ending or Ending.FAILED).value
        about = {"robot": spec.name, "robot_digest": spec.digest, "angle_deg": angle_deg}
        printing_last.callback(show, findings)
        write_report(findings, found, {**about, "seed": session.seed_text})
    if run.ending is Ending.INTERRUPTED and not run.lost:
        return INTERRUPTED
    return PASSED if findings.passed and not run.lost else BUDGET_EXCEEDED


def _check_fixed(spec: RobotSpec) -> None:
    """Refuse (ConfigError) a robot that floats: what its legs stand on moves its joints, too."""
    if spec.base is not None:
        raise ConfigError(
            f"--robot {spec.name}: found a floating base, expected a fixed one: hang the robot from its gantry, and"
            " use deploy-run --policy jog"
        )


def cli() -> None:
    """Run `deploy-check`."""
    main(check)


if __name__ == "__main__":
    cli()
