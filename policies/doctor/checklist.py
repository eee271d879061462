"""Table of all checks in the order of the report, and their execution."""

from collections.abc import Callable, Iterator

import numpy as np

from policies.doctor.check_context import CheckContext, NotSimulatedError
from policies.doctor.check_result import CheckResult, Message, failed, summarize, warned
from policies.doctor.checks.action import action, first_target, gains
from policies.doctor.checks.identity import joints, loader
from policies.doctor.checks.observations import normalizer, training
from policies.doctor.checks.robot import proprioception, protection, rates, sources
from policies.doctor.simulation.joint_order import joint_order
from policies.doctor.simulation.task_checks import chatter, delay, heat, jitter, simulation
from policies.doctor.simulation.tilt import tilt
from robots.errors import FirstshiftError

CHECKS: dict[str, Callable[[CheckContext], Iterator[Message]]] = {
    "loader": loader,
    "joints": joints,
    "action": action,
    "gains": gains,
    "rates": rates,
    "sources": sources,
    "proprioception": proprioception,
    "protection": protection,
    "normalizer": normalizer,
    "training": training,
    "tilt": tilt,
    "first target": first_target,
    "simulation": simulation,
    "joint order": joint_order,
    "chatter": chatter,
    "delay": delay,
    "jitter": jitter,
    "heat": heat,
}


def run_checks(context: CheckContext) -> Iterator[CheckResult]:
    """Yield the result of each check; a check that cannot be made fails with the reason."""
    for check in CHECKS:
        yield run_check(context, check)


def run_check(context: CheckContext, check: str) -> CheckResult:
    """Return the result of one check. Overflow is ignored: a contract may hold numbers of any size."""
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        return summarize(check, _messages(context, check))


def _messages(context: CheckContext, check: str) -> Iterator[Message]:
    try:
        yield from CHECKS[check](context)
    except NotSimulatedError:
        yield warned("not tried: see row simulation.")
    except FirstshiftError as e:
        yield failed(f"{e}.")
