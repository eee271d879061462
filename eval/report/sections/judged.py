"""Sections "monitors", "events" and "robots": rows of the judge's counts."""

from collections.abc import Sequence
from pathlib import PurePosixPath

import numpy as np

from eval.judge.counts import Counts, Event
from eval.judge.monitor import Monitor
from eval.replay.bundle import bundle_name
from eval.report.schema.rows import Channel, EventRow, MonitorRow, RobotRow
from eval.report.sections.verdict import each_confidence, interval, operating_hours
from eval.report.soak_result import SoakResult
from eval.statistics.dispersion import draw_rate_upper
from eval.statistics.evidence import rate_interval, rate_upper
from eval.statistics.numbers import number
from robots.arrays import Floats


def monitors(counts: Counts, tail_share: float) -> tuple[MonitorRow, ...]:
    """Return a row for every monitor of the robot, with or without events."""
    tail = counts.tail(tail_share)
    return tuple(_monitor(counts, monitor, tail) for monitor in counts.monitors)


def _monitor(counts: Counts, monitor: Monitor, tail: Floats) -> MonitorRow:
    columns = counts.columns(monitor.name)
    judged = bool(np.isfinite(counts.limits[columns]).all())
    events, hours = counts.events[:, columns].sum(axis=1), judged * operating_hours(counts)
    total, exposure = int(events.sum()), float(hours.sum())
    family_upper = draw_rate_upper(events, hours, each_confidence(counts))
    return MonitorRow(
        name=monitor.name,
        unit=monitor.unit,
        hard=monitor.hard,
        meaning=monitor.meaning,
        evaluations=counts.evaluations if judged else 0,
        events=total,
        unlisted=counts.left_out(monitor.name),
        bad_draws=counts.bad_draws(monitor.name),
        rate_upper=number(rate_upper(total, exposure)),
        rate_interval=interval(rate_interval(total, exposure)),
        draw_rate_upper=number(draw_rate_upper(events, hours)),
        family_rate_upper=number(family_upper) if monitor.hard else None,
        channels=_channels(counts, monitor, tail),
        load_histogram=_load_histogram(counts, columns),
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


def _load_histogram(counts: Counts, columns: slice) -> tuple[int, ...]:
    """Histogram of judged ticks; ticks of diverged simulations, counted in the first bin, are subtracted."""
    bins = counts.bins[columns].sum(axis=0)
    if not bins.any():
        return ()
    bins[0] -= counts.invalid.sum() * (columns.stop - columns.start)
    return tuple(bins.tolist())


def events(counts: Counts, bundles: Sequence[str]) -> tuple[EventRow, ...]:
    """Return the events recorded one by one, hard ones first, each with its bundle if there is one."""
    known = {PurePosixPath(bundle).name: bundle for bundle in bundles}
    log = sorted(counts.log(), key=lambda event: (not event.monitor.hard, event.start, event.robot))
    names = (bundle_name(event.robot, event.start, event.monitor.name) for event in log)
    return tuple(_event(event, counts.dt, known.get(name)) for event, name in zip(log, names, strict=True))


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
    """Return a row for every draw."""
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
    """(R,) h from which on events of a robot are not listed: its shard had reached the limit for that monitor."""
    monitor, shard = counts.channels.monitor_index, np.arange(counts.robots) // shard_width
    listed, last = np.zeros_like(counts.events), np.zeros((1 + shard[-1], len(counts.channels.catalogue)))
    np.add.at(listed, (counts.log_robot, counts.log_channel), 1)
    np.maximum.at(last, (shard[counts.log_robot], monitor[counts.log_channel]), counts.log_start)
    since = np.where(counts.events > listed, last[shard[:, None], monitor], np.inf).min(axis=1)
    return np.asarray(since * counts.dt / 3600)
