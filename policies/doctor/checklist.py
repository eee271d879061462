"""All that the doctor looks at, in the order of its report."""

from collections.abc import Callable, Iterator

import numpy as np

from policies.doctor.check_context import Case, UntriedError
from policies.doctor.check_result import Finding, Note, failed, summed_up, warned
from policies.doctor.checks.action import action, gains
from policies.doctor.checks.first_target import activation
from policies.doctor.checks.identity import joints, loader
from policies.doctor.checks.observations import normalizer, training
from policies.doctor.checks.protection import protection
from policies.doctor.checks.rates import rates
from policies.doctor.checks.sources import sources
from policies.doctor.simulation.joint_order import orders
from policies.doctor.simulation.task_checks import chatter, delay, heat, jitter, trial
from policies.doctor.simulation.tilt import tilt
from robots.errors import FirstshiftError

CHECKS: dict[str, Callable[[Case], Iterator[Note]]] = {
    "loader": loader,
    "joints": joints,
    "action": action,
    "gains": gains,
    "rates": rates,
    "sources": sources,
    "protection": protection,
    "normalizer": normalizer,
    "training": training,
    "tilt": tilt,
    "activation": activation,
    "trial": trial,
    "orders": orders,
    "chatter": chatter,
    "delay": delay,
    "jitter": jitter,
    "heat": heat,
}


def examined(case: Case) -> Iterator[Finding]:
    """A row for each check. One that cannot be made is one that failed: it says why."""
    for check in CHECKS:
        yield row(case, check)


def row(case: Case, check: str) -> Finding:
    """One of them. A contract may hold numbers of any size."""
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        return summed_up(check, _notes(case, check))


def _notes(case: Case, check: str) -> Iterator[Note]:
    try:
        yield from CHECKS[check](case)
    except UntriedError:
        yield warned("not tried: see the trial.")
    except FirstshiftError as e:
        yield failed(f"{e}.")
