import subprocess
import sys

TICKS, ROBOTS_COUNTED = 650, 3


def first(events, monitor):
    return min(events.glob(f"*-{monitor}"))


def replayed(*arguments):
    script = "from eval.replay.cli import cli; cli()"
    return subprocess.run(
        [sys.executable, "-c", script, *map(str, arguments)], capture_output=True, text=True, check=False
    )
