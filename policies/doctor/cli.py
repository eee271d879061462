"""Command policy-check: diagnose a policy on a robot before anything moves."""

from pathlib import Path
from typing import Annotated

import typer
from rich.table import Column, Table
from rich.text import Text

from deploy.command_line import BUDGET_EXCEEDED, PASSED, main
from deploy.telemetry.plain_console import plain_console
from policies.doctor.check_context import CheckContext
from policies.doctor.check_result import CheckResult, Verdict
from policies.doctor.checklist import CHECKS, run_checks
from robots.errors import printable

STYLES = {Verdict.PASS: "green", Verdict.WARN: "yellow", Verdict.FAIL: "red"}


def policy_check(
    policy: Annotated[Path, typer.Argument(help="ONNX file of policy-export or policy-import")],
    robot: Annotated[
        str | None, typer.Option(help="robot: name or folder", show_default="the contract's")
    ] = None,
) -> int:
    """Diagnose a policy on a robot: one row per check with its reason and what to do. Exit code 1 if a check fails."""
    context, title = CheckContext(policy, robot), printable(f"checking {policy.name}")
    with plain_console(stderr=True).status(Text(title)) as status:
        findings = []
        for finding in run_checks(context):
            findings.append(finding)
            status.update(Text(f"{title}: {len(findings)} of {len(CHECKS)} checks done"))
    plain_console().print(table(findings))
    return BUDGET_EXCEEDED if any(f.verdict is Verdict.FAIL for f in findings) else PASSED


def table(findings: list[CheckResult]) -> Table:
    """Return the table of results; figures in their texts are not highlighted."""
    shown = Table(Column("check", no_wrap=True), Column("", no_wrap=True), "reason, and what to do")
    for finding in findings:
        verdict = Text(finding.verdict.name.lower(), style=STYLES[finding.verdict])
        shown.add_row(finding.check, verdict, Text(finding.text))
    return shown


def cli() -> None:
    """Entry point of `policy-check`."""
    main(policy_check)
