import subprocess
import sys

TICKS, ROBOTS_COUNTED = 650, 3


def first(events, monitor):
    return min(events.glob(f"*-{monitor}"))


SCRIPT = "from eval.replay.cli import cli; cli()"


def replayed(*arguments, script=SCRIPT):
    """`soak-replay` in a process of its own."""
    command = [sys.executable, "-c", script, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False)
