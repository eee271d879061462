"""Guards that an attack is tried without: those of `make mutants`."""

from deploy.runtime import Runtime
from eval.mutants.situation import Mutant
from eval.mutants.suite import MUTANTS
from robots.errors import ConfigError
from robots.motors.control_mode import ControlMode


def find_guard(part: str) -> Mutant:
    """Return the one removal whose description contains a text.

    Raises:
        ConfigError: none or several do.
    """
    found = [mutant for mutant in MUTANTS if part in mutant.guard]
    if len(found) != 1:
        names = "; ".join(mutant.guard for mutant in found or MUTANTS)
        raise ConfigError(f"--without {part!r}: found {len(found)} such guards, expected one of: {names}")
    return found[0]


def guarded_monitor(part: str, mode: ControlMode, hard: tuple[str, ...]) -> str:
    """Return the one of some hard monitors that must report without a guard.

    Raises:
        ConfigError: there is no such guard, or none in this mode, or its monitor is none that attacks search for.
    """
    mutant = find_guard(part)
    own = mutant.situation.mode
    if own in ("velocity", "torque") and own != mode.name.lower():
        raise ConfigError(
            f"--without {part!r}: found a guard of {own} mode, expected one of {mode.name.lower()} mode"
        )
    if mutant.monitor not in hard:
        raise ConfigError(
            f"--without {part!r}: found a guard of the monitor {mutant.monitor}, expected one of {', '.join(hard)}"
        )
    return mutant.monitor


def remove_guard(part: str, runtime: Runtime) -> None:
    """Remove a guard, and those that would act before it; an empty text removes nothing."""
    if part:
        mutant = find_guard(part)
        mutant.situation.prepare(runtime)
        mutant.remove_guard(runtime)
