"""policy-check: what speaks against a policy on a robot, before anything moves."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Column, Table
from rich.text import Text

from deploy.command_line import BUDGET_EXCEEDED, PASSED, main
from policies.doctor.check_context import Case
from policies.doctor.check_result import Finding, Verdict
from policies.doctor.checklist import CHECKS, examined

STYLES = {Verdict.PASS: "green", Verdict.WARN: "yellow", Verdict.FAIL: "red"}


def policy_check(
    policy: Annotated[Path, typer.Argument(help="ONNX file of policy-export or policy-import")],
    robot: Annotated[str | None, typer.Option(help="name or folder", show_default="the contract's")] = None,
) -> int:
    """Diagnose a policy on a robot: a row for each check, why, and what to do; fails if one of them does."""
    case = Case(policy, robot)
    with Console(stderr=True).status(f"examining {policy.name}") as status:
        findings = []
        for finding in examined(case):
            findings.append(finding)
            status.update(f"examining {policy.name}: {len(findings)} of {len(CHECKS)} checks done")
    Console().print(table(findings))
    return BUDGET_EXCEEDED if any(f.verdict is Verdict.FAIL for f in findings) else PASSED


def table(findings: list[Finding]) -> Table:
    """A row for each; what is said comes from files, and is no markup."""
    shown = Table(Column("check", no_wrap=True), Column("", no_wrap=True), "why, and what to do")
    for finding in findings:
        verdict = Text(finding.verdict.name.lower(), style=STYLES[finding.verdict])
        shown.add_row(finding.check, verdict, Text(finding.said))
    return shown


def cli() -> None:
    """Entry point of `policy-check`."""
    main(policy_check)
