"""Console of a command line."""

from rich.console import Console


def plain_console(*, width: int | None = None, stderr: bool = False) -> Console:
    """Return a console that shows text as it is: brackets and colons in names and paths are no markup, no emoji.

    The text of a status is markup on any console: pass a `Text`.
    """
    return Console(width=width, stderr=stderr, markup=False, emoji=False)
