import re

import pytest
from rich.table import Table

from deploy.telemetry.plain_console import plain_console
from support.paths import ROOT

NAME = "[/x] [red]a[/red] :smile: \\[b]"


def test_names_are_no_markup(capsys):
    table = Table(NAME, title=NAME, caption=NAME)
    table.add_row(NAME)
    plain_console(width=100).print(NAME)
    plain_console(width=100).print(table)
    assert capsys.readouterr().out.count(NAME) == 5


@pytest.mark.parametrize("layer", ["robots", "deploy", "eval", "policies"])
def test_consoles_are_made_in_one_way(layer):
    """The display of a run imports no other console; a quiet one prints nothing."""
    made = {
        (path.name, call)
        for path in (ROOT / layer).rglob("*.py")
        for call in re.findall(r"\bConsole\((?!quiet=True\)).*", path.read_text())
    }
    plain = "markup=False, emoji=False)"
    assert all(plain in call for _, call in made)
    assert {name for name, _ in made} <= {"plain_console.py", "console_display.py"}
