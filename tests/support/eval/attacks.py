from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from eval.attack.archive import Archive
from eval.attack.arena import Outcome, Setting
from eval.attack.peak import Bundle
from eval.replay.bundle import INFO
from eval.shard.job import WIDTH
from robots.motors.control_mode import ControlMode
from robots.spec import load_robot


@dataclass(frozen=True, slots=True, kw_only=True)
class ShortSetting(Setting):
    """Trials of a second, in worker processes, too."""

    @property
    def seconds(self):
        """Length of a trial, s."""
        return 1.0


def planted_workers(robot, before=lambda blocks: None, after=lambda name: None, **ratios):
    """Workers whose trials all end with the same ratios: 0.5 where none is given.

    `before` is called with the blocks of each generation, `after` with the name of each bundle that was written.
    """
    names = [monitor.name for monitor in Archive(load_robot(robot), ControlMode.POSITION).monitors]
    worst = {name: np.full(WIDTH, ratios.get(name, 0.5)) for name in names}

    class Planted:
        def evaluate(self, blocks):
            before(blocks)
            return [Outcome(worst, np.zeros(WIDTH, dtype=bool)) for _ in blocks]

        def write_bundles(self, found, folder):
            for name, each in found.items():
                for written in (f"bundle-of-{name}", f"later-than-{name}"):
                    (folder / written).mkdir(parents=True)
                    (folder / written / INFO).touch()
                yield name, Bundle(f"bundle-of-{name}", each.ratio)
                after(name)

    @contextmanager
    def workers(setting, processes):
        yield Planted()

    return workers
