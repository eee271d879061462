"""Starts of the command lines of eval."""

from functools import partial

from deploy.start import start

soak_attack = partial(start, "eval.attack.cli")
soak_replay = partial(start, "eval.replay.cli")
soak_report = partial(start, "eval.report.cli")
soak_test = partial(start, "eval.soak.cli")
