"""Starts of the command lines of policies."""

from functools import partial

from deploy.start import start

policy_check = partial(start, "policies.doctor.cli")
policy_export = partial(start, "policies.export.cli")
policy_import = partial(start, "policies.importers.watched_cli")
policy_train = partial(start, "policies.training.cli")
robot_init = partial(start, "policies.robot_init.cli")
