"""Profiles of a soak: duration, number of robots, budget and scheduled faults, from a TOML file."""

from pathlib import Path
from typing import Annotated

from pydantic import Field

from eval.faults.schedule import HOURS_MAX, FaultSettings
from robots.errors import ConfigError
from robots.strict import Strict, read_toml

PROFILES = Path(__file__).parents[1] / "profiles"


class Profile(Strict):
    """One file of eval/profiles, or a user's own.

    Attributes:
        meaning: one sentence for the reader. hours: simulated hours of each robot. robots: number of robots, each
            with its own draw.
        budget: the budget file, relative to the profile's folder.
        faults: fault injection; None for no faults.
    """

    meaning: Annotated[str, Field(min_length=1)]
    hours: Annotated[float, Field(gt=0, le=HOURS_MAX)]
    robots: Annotated[int, Field(ge=1, le=100_000)]
    budget: Annotated[str, Field(min_length=1)]
    faults: FaultSettings | None = None


def load_profile(name: str) -> tuple[Profile, Path]:
    """Read a profile by its name in eval/profiles or by its path, and return it with the path of its budget.

    Raises:
        ConfigError: there is no such profile, or the file is unreadable, misspelt or out of bounds.
    """
    path = Path(name) if name.endswith(".toml") else PROFILES / f"{name}.toml"
    if path.parent == PROFILES and not path.is_file():
        known = ", ".join(sorted(file.stem for file in PROFILES.glob("*.toml")))
        raise ConfigError(f"--profile {name}: found no such profile, expected a file.toml or one of: {known}")
    profile = read_toml(path, Profile)
    return profile, (path.parent / profile.budget).resolve()
