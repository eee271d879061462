"""Every fault class under the library of adversaries: the hard monitors that come closest to their limits.

Each of 16 drawn robots gets the fault once while an adversary moves it. It is `soak-attack --fault` that searches.
"""

from functools import partial
from pathlib import Path

from rich.console import Console

from eval.attack.arena import Setting, try_block
from eval.attack.fault_classes import ALL, find_faults
from eval.attack.pool import processes
from eval.attack.search import Search
from eval.bench.soak_setup import SEED
from robots.motors.control_mode import ControlMode
from robots.spec import RobotSpec

WORKERS, SHOWN = 2, 4
Worst = list[tuple[str, float]]


def worst_of(spec: RobotSpec, fault: str) -> Worst:
    """Return the hard monitors with their highest ratios, the worst first."""
    setting = Setting(robot=spec.folder, mode=ControlMode.POSITION, faults=(fault,))
    search = Search(
        spec,
        setting.mode,
        lambda blocks: [try_block(setting, each) for each in blocks],
        seed=SEED,
        pushed_arms=(),
    )
    next(search.run())
    found = {name: search.archive.worst[name].ratio for name in search.archive.hard}
    return sorted(found.items(), key=lambda each: -each[1])


def attacked_faults(spec: RobotSpec, policy: Path, console: Console) -> None:
    """Print a row of a table for each fault class, as soon as it was tried."""
    del policy
    classes = find_faults((ALL,), spec, ControlMode.POSITION, "bench")
    with processes(WORKERS) as pool:
        found = pool.results([partial(worst_of, spec, name) for name in classes])
        for name, worst in zip(classes, found, strict=True):
            console.print(row(name, worst), soft_wrap=True, highlight=False)


def row(fault: str, worst: Worst) -> str:
    """Return a row: monitors beyond their limits, or the worst one; those that planners bring to 1 are left out."""
    at_limit = ("acceleration", "jerk")
    known = [(name, ratio) for name, ratio in worst if name not in at_limit or ratio > 1.0]
    shown = [each for each in known if each[1] > 1.0][:SHOWN] or known[:1]
    return f"| {fault} | {', '.join(f'`{name}` {ratio:.2f}' for name, ratio in shown)} |"
