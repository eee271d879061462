"""From what the judge counted to the rows of monitors, events and robots."""

from collections.abc import Sequence
from pathlib import PurePosixPath

import numpy as np

from eval.judge.counts import Counts, Event
from eval.judge.monitor import Monitor
from eval.replay.bundle import bundle_name
from eval.report.schema.numbers import number
from eval.report.schema.report_data import SoakResult
from eval.report.schema.rows import Channel, EventRow, MonitorRow, RobotRow
from eval.report.sections.bounds import each_confidence, hours_under_way, interval
from eval.statistics.dispersion import draw_rate_upper
from eval.statistics.evidence import rate_interval, rate_upper
from robots.arrays import Floats


def monitors(counts: Counts, tail_share: float) -> tuple[MonitorRow, ...]:
    """Every monitor, whether anything happened or not."""
    tail = counts.tail(tail_share)
    return tuple(_monitor(counts, monitor, tail) for monitor in counts.monitors)


def _monitor(counts: Counts, monitor: Monitor, tail: Floats) -> MonitorRow:
    columns = counts.columns(monitor.name)
    judged = bool(np.isfinite(counts.limits[columns]).all())
    events, hours = counts.events[:, columns].sum(axis=1), judged * hours_under_way(counts)
    total, exposure = int(events.sum()), float(hours.sum())
    sure = draw_rate_upper(events, hours, each_confidence(counts))
    return MonitorRow(
        name=monitor.name,
        unit=monitor.unit,
        hard=monitor.hard,
        meaning=monitor.meaning,
        evaluations=counts.evaluations if judged else 0,
        events=total,
        left_out=counts.left_out(monitor.name),
        bad_draws=counts.bad_draws(monitor.name),
        rate_upper=number(rate_upper(total, exposure)),
        rate_interval=interval(rate_interval(total, exposure)),
        draw_rate_upper=number(draw_rate_upper(events, hours)),
        family_rate_upper=number(sure) if monitor.hard else None,
        channels=_channels(counts, monitor, tail),
        loads=_loads(counts, columns),
    )


def _channels(counts: Counts, monitor: Monitor, tail: Floats) -> tuple[Channel, ...]:
    columns = counts.columns(monitor.name)
    names: Sequence[str | None] = counts.joints if monitor.per_joint else (None,)
    return tuple(
        Channel(
            joint=joint,
            limit=number(counts.limits[channel]),
            events=int(counts.events[:, channel].sum()),
            bad_ticks=int(counts.bad_ticks[:, channel].sum()),
            worst=number(counts.worst[:, channel].max(initial=0.0)),
            tail=number(tail[channel]),
        )
        for joint, channel in zip(names, range(columns.start, columns.stop), strict=True)
    )


def _loads(counts: Counts, columns: slice) -> tuple[int, ...]:
    """Of the ticks that were judged: those of diverged simulations lie in the first bin."""
    bins = counts.bins[columns].sum(axis=0)
    if not bins.any():
        return ()
    bins[0] -= counts.invalid.sum() * (columns.stop - columns.start)
    return tuple(bins.tolist())


def events(counts: Counts, bundles: Sequence[str]) -> tuple[EventRow, ...]:
    """Those that were kept one by one, hard ones first, each with its bundle if it has one."""
    known = {PurePosixPath(bundle).name: bundle for bundle in bundles}
    log = sorted(counts.log(), key=lambda event: (not event.monitor.hard, event.start, event.robot))
    return tuple(_event(event, counts.dt, known.get(_bundle(event))) for event in log)


def _bundle(event: Event) -> str:
    return bundle_name(event.robot, event.start, event.monitor.name)


def _event(event: Event, dt: float, bundle: str | None) -> EventRow:
    return EventRow(
        robot=event.robot,
        monitor=event.monitor.name,
        joint=event.joint,
        hard=event.monitor.hard,
        start_h=event.start * dt / 3600,
        length_s=event.ticks * dt,
        worst=number(event.worst),
        margin=number(event.limit * (1.0 - event.worst)),
        unit=event.monitor.unit,
        bundle=bundle,
    )


def robots(result: SoakResult) -> tuple[RobotRow, ...]:
    """Every draw."""
    counts = result.counts
    hour, hard = counts.dt / 3600, counts.hard_events()
    unlisted = _unlisted(counts, result.settings.shard_width)
    stopped, latched = (np.diff(total, axis=0) > 0 for total in (result.stops, result.latches))
    return tuple(
        RobotRow(
            robot=k,
            hours=float(counts.ticks[k] * hour),
            judged_hours=float((counts.ticks[k] - counts.invalid[k]) * hour),
            running_hours=float(counts.running[k] * hour),
            goals_due=int(counts.due[k]),
            goals_reached=int(counts.reached[k]),
            stops=int(counts.stops[k]),
            latches=int(counts.latches[k]),
            hard_events=int(hard[k]),
            soft_events=int(counts.events[k].sum() - hard[k]),
            stopped_h=tuple(result.sample_h[1:][stopped[:, k]].round(4).tolist()),
            latched_h=tuple(result.sample_h[1:][latched[:, k]].round(4).tolist()),
            unlisted_h=number(unlisted[k], 4),
        )
        for k in range(counts.robots)
    )


def _unlisted(counts: Counts, shard_width: int) -> Floats:
    """(R,) h from which on events of a robot were counted only: its shard had kept enough of that monitor."""
    of, shard = counts.channels.monitor_index, np.arange(counts.robots) // shard_width
    kept, last = np.zeros_like(counts.events), np.zeros((1 + shard[-1], len(counts.channels.catalogue)))
    np.add.at(kept, (counts.log_robot, counts.log_channel), 1)
    np.maximum.at(last, (shard[counts.log_robot], of[counts.log_channel]), counts.log_start)
    since = np.where(counts.events > kept, last[shard[:, None], of], np.inf).min(axis=1)
    return np.asarray(since * counts.dt / 3600)
