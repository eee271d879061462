"""deploy-run: drive one robot by a policy, or by hand, at a fixed rate, from arming to rest."""

import math
import os
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import typer

from deploy.command_line import BUDGET_EXCEEDED, PASSED, main
from deploy.operation.interrupts import Interrupts, handled
from deploy.operation.jog import Jog, reduced_speed
from deploy.operation.jog_keys import JogKeys
from deploy.operation.keyboard import Keyboard
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
from deploy.policy.compatibility import check_contract
from deploy.policy.policy import Policy
from deploy.policy.policy_file import read_policy_file
from deploy.policy.step_trial import check_step
from deploy.start import INTERRUPTED
from robots.errors import ConfigError
from robots.spec import RobotSpec, load_robot

EXIT: dict[Ending | None, int] = {Ending.DONE: PASSED, Ending.INTERRUPTED: INTERRUPTED}
JOG = "jog"
"""Word in the place of a policy: the operator moves joints by keys."""

PolicyFile = Annotated[
    str,
    typer.Option(help=f"ONNX file written by policy-export; {JOG}: move one joint at a time by keys, slowly"),
]
Duration = Annotated[float, typer.Option(help="s of robot time; inf: until Ctrl-C")]


def run(
    policy: PolicyFile = "out/arm.onnx",
    robot: RobotName = "arm6",
    backend: BackendName = "sim",
    duration: Duration = math.inf,
    speed: Speed = "1",
    seed: Seed = None,
    draw: DrawName = None,
    out: Out = Path("out/run"),
    view: ViewFlag = False,
) -> int:
    """Drive one robot by a policy, or by hand: arm, work, and come to rest.

    Ctrl-C, or any other signal that would end a process, asks for a controlled stop; a second Ctrl-C cuts power. Exit
    codes: 0 done, 1 the robot stopped and could not go on, or a file of the run could not be kept, 2 bad input and
    nothing moved, 70 internal error, 130 interrupted.
    """
    spec = load_robot(robot)
    options = Options(
        spec=spec,
        backend=backend,
        duration=duration,
        speed=speed,
        seed=seed,
        draw=draw,
        out=out,
        view=view,
    )
    interrupts = Interrupts()
    session = Session(options, interrupts)
    with ExitStack() as printing, handled(interrupts), ExitStack() as stack:
        drive = _by_hand(spec, stack) if policy == JOG else _by_policy(policy, spec)
        finished = session.run(drive, printing)
    return BUDGET_EXCEEDED if finished.lost else EXIT.get(finished.ending, BUDGET_EXCEEDED)


def _by_policy(policy: str, spec: RobotSpec) -> Drive:
    """Return what moves a robot by a policy whose step was tried first.

    Raises:
        ContractError: the file is no policy, does not fit the robot, or needs too much time or memory.
    """
    file = read_policy_file(Path(policy))
    check_contract(file.contract, spec, f"{policy}: contract")
    check_step(file.data, 1 / file.contract.policy_hz, policy)
    actor = Policy.verified(file, policy, spec)
    return Drive(name=policy, actor=actor, spec=spec, inputs=[Path(policy)])


def _by_hand(spec: RobotSpec, stack: ExitStack) -> Drive:
    """Return what moves a robot by keys; the terminal is as before when `stack` closes.

    Raises:
        ConfigError: a file has the name of the word, or there is no input.
    """
    if os.path.exists(JOG):
        raise ConfigError(f"--policy {JOG}: found a file of that name, expected ./{JOG} for it, or none here")
    keyboard, slow = stack.enter_context(Keyboard()), reduced_speed(spec)
    actor = Jog(slow)
    keys = JogKeys(actor, keyboard, slow)
    return Drive(
        name=JOG,
        actor=actor,
        spec=slow,
        watchers=[keys],
        title=lambda: f"{spec.name}  {keys.title}",
        joint=lambda: keys.joint,
    )


def cli() -> None:
    """Run `deploy-run`."""
    main(run)


if __name__ == "__main__":
    cli()
