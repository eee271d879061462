"""Effects of faults on what passes between computer and drives: commands, power, and the computer's ticks.

A late tick is simulated as one: before the computer reads, the robot goes on for the slots that were skipped, under the
command that its drives have. The runtime's clock does not count these slots, as on a real robot, and its loop timing
does. The judge sees the robot once for each tick of the runtime: of the skipped slots it sees the end.

The injector repairs the bus before each tick: effects of one robot add up.
"""

from eval.faults.fault_class import Injection
from eval.faults.late_ticks import SKIPPED
from eval.faults.plant_effects import PlantAccess

EVERY = 5
"""One command of so many is an old one, on a bus that repeats."""
OLD_S, LATE_S = 0.025, 0.05
"""Age of a repeated command, and delay of all commands of a bus that is late, s."""


def lose_commands(access: PlantAccess, injection: Injection, active: bool, *, of: int = 1) -> None:
    """Lose one command of `of`; drives keep the one before."""
    place = access.tick - injection.begins
    access.plant.bus.lost[injection.robot] |= active and place % of == 0


def repeat_commands(access: PlantAccess, injection: Injection, active: bool) -> None:
    """Deliver an old command in the place of one of `EVERY`."""
    if active and (access.tick - injection.begins) % EVERY == 0:
        _delay(access, injection.robot, OLD_S)


def delay_commands(access: PlantAccess, injection: Injection, active: bool) -> None:
    """Deliver every command late."""
    if active:
        _delay(access, injection.robot, LATE_S)


def _delay(access: PlantAccess, robot: int, late_s: float) -> None:
    late = access.plant.bus.late
    late[robot] = max(late[robot], round(late_s / access.dt))


def disable_drives(access: PlantAccess, injection: Injection, active: bool) -> None:
    """Take the controller or the supply of all drives down: brakes close, and commands are ignored."""
    access.plant.bus.down[injection.robot] |= active


def hang(access: PlantAccess, injection: Injection, active: bool, *, late_s: float) -> None:
    """Delay the first tick of the fault."""
    if active and access.tick == injection.begins:
        access.plant.late[injection.robot] += round(late_s / access.dt)


def run_late(access: PlantAccess, injection: Injection, active: bool) -> None:
    """Delay ticks as a real computer did, from a place of its trace that differs between injections."""
    if active:
        begin = injection.robot * 7919 + injection.slot * 104729  # primes: places that hardly repeat
        place = begin + access.tick - injection.begins
        access.plant.late[injection.robot] += int(SKIPPED[place % len(SKIPPED)])
