"""Starts of the command lines of policies."""

from functools import partial

from deploy.start import start
from policies.importers.untrusted.watched_process import run_watched

policy_check = partial(start, "policies.doctor.cli")
policy_export = partial(start, "policies.export.cli")
policy_import = partial(run_watched, partial(start, "policies.importers.cli"))
policy_train = partial(start, "policies.training.cli")
robot_init = partial(start, "policies.robot_init.cli")
