"""Options of soak-test, profiles of options from TOML files, and the configuration that they make."""

import os
from pathlib import Path
from typing import Annotated

import typer
from pydantic import Field

from deploy.policy.compatibility import sensors_read
from deploy.policy.policy import Policy
from deploy.policy.tried_policy import read_tried_policy
from eval.faults.catalogue import check_names
from eval.faults.schedule import FIRST_S, HOURS_MAX, FaultSettings, hours_max
from eval.soak.configuration import SoakConfig
from eval.statistics.budget import BUDGET
from robots.errors import ConfigError
from robots.randomness import SEED_MAX
from robots.spec import load_robot
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
    budget: Annotated[str, Field(pattern=r"^[^\x00]+$")]
    faults: FaultSettings | None = None


def load_profile(name: str) -> tuple[Profile, Path]:
    """Read a profile by its name in eval/profiles or by its path, and return it with the path of its budget.

    Raises:
        ConfigError: there is no such profile, or the file is unreadable, misspelt or out of bounds.
    """
    path = _profile_path(name)
    if path.parent == PROFILES and not os.path.isfile(path):
        known = ", ".join(sorted(file.stem for file in PROFILES.glob("*.toml")))
        raise ConfigError(f"--profile {name}: found no such profile, expected a file.toml or one of: {known}")
    profile = read_toml(path, Profile)
    return profile, Path(os.path.realpath(path.parent / profile.budget))


def _profile_path(name: str) -> Path:
    return Path(name) if name.endswith(".toml") else PROFILES / f"{name}.toml"


DEFAULTS = Profile(meaning="options without a profile", hours=8.0, robots=32, budget=BUDGET.name)

PolicyFile = Annotated[Path, typer.Option(help="ONNX file from policy-export.")]
Robot = Annotated[str, typer.Option(help="Robot: a name or a folder.")]
ProfileName = Annotated[
    str | None,
    typer.Option(
        help="smoke, shift, nightly, faults, weekend or a file.toml; overridden by explicit options."
    ),
]
Hours = Annotated[
    float | None, typer.Option(help="Simulated hours of each robot.", show_default="8, or the profile's")
]
Robots = Annotated[
    int | None,
    typer.Option(help="Number of robots, each with its own draw.", show_default="32, or the profile's"),
]
Seed = Annotated[int, typer.Option(help="Seed of all draws, noise and goals.")]
Workers = Annotated[int, typer.Option(help="Number of processes; results do not depend on it.")]
BudgetFile = Annotated[
    Path | None, typer.Option(help="TOML file of limits to pass.", show_default="the profile's")
]
Out = Annotated[
    Path,
    typer.Option(
        help="Folder for report.json, report.html, junit.xml, draws.json, series.parquet, tensorboard/."
    ),
]
History = Annotated[
    Path | None,
    typer.Option(
        help="Folder for a record of the finished soak; the report shows the trend over all records."
    ),
]


def configure(
    policy: Path,
    robot: str,
    profile: str | None,
    hours: float | None,
    robots: int | None,
    seed: int,
    workers: int,
    budget: Path | None,
) -> SoakConfig:
    """Combine profile and options, which override it.

    Raises:
        ConfigError: an option, the profile, the robot or the policy is invalid.
    """
    defaults, default_budget = (DEFAULTS, BUDGET) if profile is None else load_profile(profile)
    hours_field = f"{_profile_path(profile)}: hours" if profile is not None and hours is None else "--hours"
    hours = defaults.hours if hours is None else hours
    robots = defaults.robots if robots is None else robots
    _check_hours(hours_field, hours, defaults.faults)
    _check_options(robots, seed, workers)
    spec = load_robot(robot)
    loaded = Policy.verified(read_tried_policy(policy), str(policy), spec)
    if profile is not None and defaults.faults and defaults.faults.classes:
        field = f"{_profile_path(profile)}: faults.classes"
        check_names(defaults.faults.classes, spec, sensors_read(loaded.contract, spec), field)
    return SoakConfig(
        spec=spec,
        policy=loaded,
        policy_path=policy,
        budget=default_budget if budget is None else budget,
        hours=hours,
        robots=robots,
        seed=seed,
        workers=workers,
        faults=defaults.faults,
    )


def _check_hours(field: str, hours: float, faults: FaultSettings | None) -> None:
    cycle, longest = (FIRST_S + faults.cycle_s) / 3600 if faults else 0.0, hours_max(faults)
    _check(
        (field, hours, 0 < hours <= longest, f"above 0 and at most {longest:.5g}"),
        (field, hours, hours >= cycle, f"at least {cycle:.3g}: time for one fault"),
    )


def _check_options(robots: int, seed: int, workers: int) -> None:
    _check(
        ("--robots", robots, 1 <= robots <= 100_000, "from 1 to 100000"),
        ("--seed", seed, 0 <= seed <= SEED_MAX, f"from 0 to {SEED_MAX}"),
        ("--workers", workers, 1 <= workers <= 1024, "from 1 to 1024"),
    )


def _check(*bounds: tuple[str, float, bool, str]) -> None:
    for name, value, valid, expected in bounds:
        if not valid:
            raise ConfigError(f"{name}: found {value}, expected {expected}")
