"""Check that the robot has a sensor or estimator for each observation term."""

from collections.abc import Iterator

from deploy.tasks.task import sources_of
from policies.doctor.check_context import CheckContext
from policies.doctor.check_result import Message, failed, passed, warned


def sources(context: CheckContext) -> Iterator[Message]:
    """List the sensor or estimator of each term."""
    sensors, supplies, known = context.spec.sensors, [], sources_of(context.contract.task)
    for term in context.contract.observation:
        declared = known[term.source]
        if missing := [kind for kind in declared.sensors if kind not in sensors]:
            yield failed(
                f"{term.name} ({term.source}) needs {' and '.join(missing)}, {context.spec.name} has"
                f" {', '.join(sensors)}: add the sensor to robot.toml and to the robot, or train without the term."
            )
        elif refused := [
            line for line in context.incompatibilities if line.startswith(f"observation.{term.name}.source")
        ]:
            yield failed(f"{refused[0]}.")
        elif declared.doubt:
            yield warned(f"{term.name} ({term.source}): {declared.doubt}.")
        supplies.append(f"{term.name}: {declared.supply}")
    yield passed("; ".join(supplies) + ".")
