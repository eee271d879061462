"""Report of the check: a table for the operator, and the same as JSON."""

import json
import math
from pathlib import Path
from typing import Any

from rich.table import Table
from rich.text import Text

from deploy.commissioning.bounds import Measured
from deploy.commissioning.findings import QUANTITIES, Findings, JointFindings
from deploy.telemetry.output_files import replacing
from deploy.telemetry.plain_console import plain_console
from robots.errors import OutputError, ResultLostError


def write_report(findings: Findings, path: Path, about: dict[str, Any]) -> None:
    """Write JSON to `path`.

    Raises:
        ResultLostError: the file cannot be written.
    """
    data = {"passed": findings.passed, **about, "stopped": findings.stopped}
    data["joints"] = {joint.name: _joint_data(joint) for joint in findings.joints}
    data["unverified"] = findings.unverified
    try:
        with replacing(path) as partial:
            partial.write_text(json.dumps(data, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
    except OutputError as e:
        raise ResultLostError(f"not kept: report {e}") from e


def _joint_data(joint: JointFindings) -> dict[str, Any]:
    """Return plain data in SI units; None in the place of an infinite bound."""
    numbers = {
        name: {key: value if math.isfinite(value) else None for key, value in measured._asdict().items()}
        for name, measured in joint.measured.items()
    }
    head = {"passed": joint.passed, "order": joint.order, "sign": joint.sign}
    return {**head, **numbers, "mistakes": joint.mistakes}


def show(findings: Findings) -> None:
    """Print the table and the verdict."""
    console = plain_console()
    table = Table(
        title="measured, and expected below it", title_justify="left", box=None, padding=(0, 1, 0, 0)
    )
    table.add_column("joint")
    table.add_column("order")
    for quantity in QUANTITIES:
        table.add_column(f"{quantity.name}\n{quantity.unit}", justify="right")
    for joint in findings.joints:
        table.add_row(*_cells(joint))
    console.print(table)
    for text in (f"{joint.name}: {mistake}" for joint in findings.joints for mistake in joint.mistakes):
        console.print(Text(text, style="red"), soft_wrap=True)
    if findings.stopped:
        console.print(Text(f"stopped: {findings.stopped}", style="red"), soft_wrap=True)
    for text in findings.unverified:
        console.print(Text(f"gravity cannot exclude, see by jog: {text}"), soft_wrap=True)
    console.print("passed" if findings.passed else "failed")


def _cells(joint: JointFindings) -> list[Text]:
    sign = {1: "+", -1: "-", None: ""}[joint.sign]
    order = "ok" if joint.order == joint.name else joint.order or "?"
    cells = [Text(joint.name, style="" if joint.passed else "red"), Text(f"{sign} {order}")]
    for quantity in QUANTITIES:
        measured = joint.measured.get(quantity.name)
        cells.append(_cell(measured, quantity.size) if measured else Text("-"))
    return cells


def _cell(measured: Measured, size: float) -> Text:
    value, low, high = (number / size for number in measured)
    bounds = "" if math.isinf(high) else f"{low:.3g}…{high:.3g}"
    return Text(f"{value:.3g}\n{bounds}", style="" if measured.inside else "red")
