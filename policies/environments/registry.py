"""Registration of environments with Gymnasium, done when this module is imported.

For every robot in robots/, every installed task that it has the capabilities for and every control mode of its drives
there is `firstshift/ROBOT-TASK-MODE-v0`; with goals for hindsight there is `firstshift/ROBOT-TASK-MODE-goal-v0`, unless
the task counts its goals by the mean of their period.
"""

from itertools import product

import gymnasium

from deploy.tasks.task import tasks_of
from policies.environments.settings import hindsight, modes_of
from robots.spec import ROBOTS, load_robot

SINGLE, VECTOR = "policies.environments.single", "policies.environments.vector"


def environment_ids() -> dict[str, dict[str, str]]:
    """Return robot, task and mode of every environment by its id."""
    ids = {}
    for path in sorted(ROBOTS.glob("*/robot.toml")):
        spec = load_robot(path.parent)
        for task, mode in product(tasks_of(spec), modes_of(spec)):
            options = {"robot": spec.name, "task": task, "mode": mode}
            ids[f"firstshift/{spec.name}-{task}-{mode}-v0"] = options
            if hindsight(task, spec):
                ids[f"firstshift/{spec.name}-{task}-{mode}-goal-v0"] = options
    return ids


def _register() -> None:
    for name, options in environment_ids().items():
        kind = "RobotGoal" if name.endswith("-goal-v0") else "Robot"
        gymnasium.register(
            id=name,
            entry_point=f"{SINGLE}:{kind}Env",
            vector_entry_point=f"{VECTOR}:{kind}VectorEnv",
            kwargs=dict(options),
        )


_register()
