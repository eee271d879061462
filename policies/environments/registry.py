"""Registration of environments with Gymnasium, done when this module is imported.

For every robot in robots/, every installed task that it has the capabilities for and every control mode of its drives
there are `firstshift/ROBOT-TASK-MODE-v0` and, with goals for hindsight, `firstshift/ROBOT-TASK-MODE-goal-v0`.
"""

import gymnasium

from deploy.tasks.task import tasks_of
from policies.environments.settings import modes_of
from robots.spec import ROBOTS, load_robot

SINGLE, VECTOR = "policies.environments.single", "policies.environments.vector"


def environment_ids() -> dict[str, dict[str, str]]:
    """Return robot, task and mode of every environment, by the name that its ids begin with."""
    robots = [load_robot(path.parent) for path in sorted(ROBOTS.glob("*/robot.toml"))]
    return {
        f"firstshift/{spec.name}-{task}-{mode}": {"robot": spec.name, "task": task, "mode": mode}
        for spec in robots
        for task in tasks_of(spec)
        for mode in modes_of(spec)
    }


def _register() -> None:
    for name, options in environment_ids().items():
        for suffix, kind in (("", "Robot"), ("-goal", "RobotGoal")):
            gymnasium.register(
                id=f"{name}{suffix}-v0",
                entry_point=f"{SINGLE}:{kind}Env",
                vector_entry_point=f"{VECTOR}:{kind}VectorEnv",
                kwargs=dict(options),
            )


_register()
