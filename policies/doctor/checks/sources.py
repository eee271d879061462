"""What supplies each term of the observation on the robot itself."""

from collections.abc import Iterator

from deploy.tasks.task import sources_of
from policies.doctor.check_context import Case
from policies.doctor.check_result import Note, failed, passed, warned


def sources(case: Case) -> Iterator[Note]:
    """Term by term: which sensor or estimator there is for it."""
    sensors, told, known = case.spec.sensors, [], sources_of(case.contract.task)
    for term in case.contract.observation:
        declared = known[term.source]
        if missing := [kind for kind in declared.sensors if kind not in sensors]:
            yield failed(
                f"{term.name} ({term.source}) needs {' and '.join(missing)}, {case.spec.name} has"
                f" {', '.join(sensors)}: add the sensor to robot.toml and to the robot, or train without the term."
            )
        elif refused := [line for line in case.misfits if line.startswith(f"observation.{term.name}.source")]:
            yield failed(f"{refused[0]}.")
        elif declared.doubt:
            yield warned(f"{term.name} ({term.source}): {declared.doubt}.")
        told.append(f"{term.name}: {declared.supply}")
    yield passed("; ".join(told) + ".")
