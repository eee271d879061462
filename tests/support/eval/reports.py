import dataclasses
import html.parser
from functools import cache

import numpy as np

from deploy.policy.contract import Observed
from eval.history.soak_record import Run, Settings
from eval.report.build import build
from eval.report.html import render
from eval.report.schema.report_data import Report
from eval.report.soak_result import SoakResult
from eval.statistics.budget import load_budget
from support.arm6 import arm_judge

OBSERVED = Observed(mean=(0.0,), deviation=(1.0,))
ROBOTS, HOURS, TICKS = 16, 8.0, 8 * 3600 * 200


def wearing(hours, robots=ROBOTS):
    """Joint j of robot i at (i + j) times 1 % friction, 0.01 mrad, -0.1 mrad and -0.1 % by the end; play from 0.3."""
    life = hours[:, None, None] / HOURS * np.add.outer(np.arange(robots), np.arange(6))
    return np.stack((1.0 + 0.01 * life, 3e-4 + 1e-5 * life, -1e-4 * life, 1.0 - 0.001 * life), axis=1)


def soak(events=(), *, interrupted=False, ticks=TICKS, samples=481, policy="arm.onnx", robots=ROBOTS):
    """A shift of robots in which only `events` went wrong, on robot 3 and the monitor's first channel."""
    counts = arm_judge(np.full(6, 100.0), robots, observed=OBSERVED).counts()
    counts.ticks[:] = counts.running[:] = ticks
    counts.attempted[:] = counts.reached[:] = ticks // 800
    counts.worst[:, counts.columns("tracking")] = 0.705
    heat = counts.columns("heat_hard")  # hotter, on some tick, than on those that were sampled
    counts.worst[:, heat] = 65.0 / counts.limits[heat]
    counts.worst[5 % robots, heat.start + 2] = 80.0 / counts.limits[heat.start + 2]
    counts.bins[:, 40] = max(0, robots * ticks - 100)
    counts.bins[:, 70] = 100
    log = []
    for name in events:
        channel = counts.columns(name).start
        counts.events[3, channel] += 1
        counts.worst[3, channel] = 1.25
        log.append((3, channel, 720_000, 720_009, 1.25))
    counts = dataclasses.replace(
        counts,
        **{
            f"log_{name}": np.array([row[k] for row in log], dtype=float if name == "worst" else np.int64)
            for k, name in enumerate(("robot", "channel", "start", "last", "worst"))
        },
    )
    winding = np.linspace(25, 60, samples)[:, None, None] + np.zeros((samples, robots, 6))
    winding[:, 5 % robots, 2] += 15
    hours = np.linspace(0, HOURS, samples)
    return SoakResult(
        settings=Settings(
            command="soak-test --seed 7",
            robot="arm6",
            robot_digest="a" * 64,
            draws_digest="d" * 64,
            limits_digest="f" * 64,
            code_digest="e" * 64,
            faults=None,
            policy=policy,
            policy_digest="b" * 64,
            budget="budget.toml",
            seed=7,
            hours=HOURS,
            robots=robots,
            shard_width=16,
            workers=2,
            versions={"numpy": "2.4"},
        ),
        run=Run(
            started="2026-01-02T03:04:05+00:00",
            wall_s=60.0,
            hours=ticks / 720_000,
            resumed_hours=0.0,
            interrupted=interrupted,
        ),
        counts=counts,
        sample_h=hours,
        winding_c=winding,
        folded_back=np.zeros_like(winding),
        worn=wearing(hours, robots),
        stops=np.zeros((samples, robots), dtype=np.int64),
        latches=np.zeros((samples, robots), dtype=np.int64),
        goals_bin_h=1.0,
        goals_attempted=np.full(8, 14_400),
        goals_reached=np.array([14_400] * 7 + [14_000]),
        parameters={"payload.mass_kg": np.linspace(0, 1, robots), "cable.length_m": np.ones(robots)},
        bundles=(),
    )


def report(*args, **kwargs):
    return build(soak(*args, **kwargs), load_budget())


def rendered(found):
    """The page of a report; pages of equal reports are rendered once in a process."""
    return _page(found.model_dump_json())


@cache
def _page(found):
    return render(Report.model_validate_json(found))


class Page(html.parser.HTMLParser):
    """Tags that are open, ids, and all that a browser would load."""

    def __init__(self, text):
        super().__init__()
        self.open, self.ids, self.loads, self.words = [], [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        if tag not in {"meta", "link", "br", "path", "use", "rect", "circle", "line", "image"}:
            self.open.append(tag)
        for name, value in attrs:
            if name == "id":
                self.ids.append(value)
            if name in {"src", "href", "xlink:href", "data", "action"}:
                self.loads.append(value)

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if self.open and self.open[-1] == tag:
            self.open.pop()

    def handle_endtag(self, tag):
        if tag not in {"path", "use", "rect", "circle", "line", "image"}:
            assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)


BUNDLE = "events/0003-00720000-velocity"
