"""Profiles: what a soak is for, how long and wide it is, what it may cost, and which faults befall its robots."""

from pathlib import Path
from typing import Annotated

from pydantic import Field

from robots.errors import ConfigError
from robots.strict import Strict, read_toml

PROFILES = Path(__file__).parents[1] / "profiles"
HOURS_MAX = 10_000.0
"""h that a robot may be asked to live."""
LEAST_CYCLE_S = 18.0
"""s that the longest fault, its operator and a start anew take at the least."""


class Faults(Strict):
    """When faults are injected: each robot suffers one of every class in turn, in an order of its own.

    Attributes:
        coverage: share of the injections of each class that must be handled, and be shown to be with 95 %.
        cycle_s: s from one fault of a robot to its next.
        operator_s: s that a robot without power waits for its operator, who comes sooner than to a robot at work.
    """

    coverage: Annotated[float, Field(gt=0, lt=1)]
    cycle_s: Annotated[float, Field(ge=LEAST_CYCLE_S)]
    operator_s: Annotated[float, Field(ge=0, le=LEAST_CYCLE_S)]


class Profile(Strict):
    """A file of eval/profiles, or of a user's own.

    Attributes:
        meaning: for the reader. hours: simulated, of each robot. robots: how many, each its own draw.
        budget: the file of what it may cost, seen from the profile's folder.
        faults: on schedule; None for no fault at all.
    """

    meaning: Annotated[str, Field(min_length=1)]
    hours: Annotated[float, Field(gt=0, le=HOURS_MAX)]
    robots: Annotated[int, Field(ge=1, le=100_000)]
    budget: Annotated[str, Field(min_length=1)]
    faults: Faults | None = None


def load_profile(name: str) -> tuple[Profile, Path]:
    """Read a profile: one of firstshift's by its name, or a file; and find its budget.

    Raises:
        ConfigError: no such profile, or a file that is unreadable, misspelt or out of bounds.
    """
    path = Path(name) if name.endswith(".toml") else PROFILES / f"{name}.toml"
    if path.parent == PROFILES and not path.is_file():
        known = ", ".join(sorted(file.stem for file in PROFILES.glob("*.toml")))
        raise ConfigError(f"--profile {name}: found no such profile, expected a file.toml or one of: {known}")
    profile = read_toml(path, Profile)
    return profile, (path.parent / profile.budget).resolve()
