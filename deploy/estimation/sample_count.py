"""Durations in seconds, converted to counts of samples."""


def sample_count(duration_s: float, period_s: float) -> int:
    """Return the number of samples of `period_s` in `duration_s`, at least 1."""
    return max(1, round(duration_s / period_s))
