"""make attack: try the cases that attacks have found again; every guard must hold."""

import time
from pathlib import Path
from typing import Annotated

import typer

from deploy.command_line import BUDGET_EXCEEDED, PASSED, main
from deploy.telemetry.plain_console import plain_console
from eval.attack.suite import SUITE, Result, run_suite
from robots.errors import printable


def attack(cases: Annotated[Path, typer.Option(help="Folder of cases.")] = SUITE) -> int:
    """Try every case of a regression suite.

    Exit codes: 0 no hard event, 1 a hard event, 2 bad input.
    """
    console, began, results = plain_console(width=160), time.monotonic(), list[Result]()
    for result in run_suite(cases):
        results.append(result)
        console.print(printable(_line(result)), highlight=False, soft_wrap=True)
    failed = sum(bool(result.events) for result in results)
    console.print(f"{failed} of {len(results)} cases failed, in {time.monotonic() - began:.0f} s")
    return BUDGET_EXCEEDED if failed else PASSED


def _line(result: Result) -> str:
    case, now = result.case, result.worst(result.case.monitor)
    then = "no number" if case.worst is None else f"{case.worst:.4f}"
    margin = f"{case.monitor} {now:.4f} of its limit, {then} when it was found"
    return f"{result.path.stem} ({case.adversary}): {margin}; hard events: {', '.join(result.events) or '0'}"


if __name__ == "__main__":
    main(attack)
