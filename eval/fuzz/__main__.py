"""make fuzz: mutated files for every reader of files of unknown origin.

A reader may accept a file or refuse it with an error of firstshift, in bounded time and memory. Anything else is a
failure: its files are kept.

python -m eval.fuzz                                        readers of a computer without torch
python -m eval.fuzz --table policies.fuzz.targets:TARGETS   these, and the importers
"""

import shutil
from pathlib import Path
from typing import Annotated

import typer

from deploy.command_line import BUDGET_EXCEEDED, PASSED, main
from deploy.telemetry.plain_console import plain_console
from eval.fuzz.campaign import Findings, run_campaign
from eval.fuzz.target import find_targets
from eval.fuzz.worker import ACCEPTED, REFUSED
from robots.errors import ConfigError, printable

TABLE = "eval.fuzz.targets:TARGETS"
console = plain_console(width=160)


def fuzz(
    seconds: Annotated[float, typer.Option(help="s for all readers together")] = 3600.0,
    seed: Annotated[int, typer.Option(help="of the mutations")] = 7,
    only: Annotated[str, typer.Option(help="reader, by its name")] = "",
    out: Annotated[Path, typer.Option(help="folder for files that a reader fails on; replaced")] = Path(
        "out/fuzz"
    ),
    table: Annotated[str, typer.Option(help="module and name of the table of readers")] = TABLE,
) -> int:
    """Read mutated files with every reader, and print what came of them.

    Exit codes: 0 passed, 1 a reader failed.
    """
    targets = find_targets(table)
    if only and only not in targets:
        raise ConfigError(f"--only {only}: found no such reader, expected one of {', '.join(targets)}")
    shutil.rmtree(out, ignore_errors=True)
    chosen, failed = [only] if only else [*targets], False
    for name in chosen:
        share = seconds / len(chosen)
        found = run_campaign(table, name, targets[name], out, seed=seed, seconds=share)
        _print(name, found, out / f"{name}-{seed}")
        failed = failed or bool(found.failures)
    return BUDGET_EXCEEDED if failed else PASSED


def _print(name: str, found: Findings, place: Path) -> None:
    counts = f"{found.counts[ACCEPTED]} accepted, {found.counts[REFUSED]} refused"
    console.print(
        f"{name}: {found.cases} files, {counts}, the slowest after {found.slowest:.1f} s;"
        f" {len(found.failures)} failures",
        highlight=False,
    )
    for number, failure in sorted(found.failures.items()):
        console.print(printable(f"  {place}-{number}: {failure}"), highlight=False)


if __name__ == "__main__":
    main(fuzz)
