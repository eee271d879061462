"""Profiles: those that are shipped, one's own, and what is said of a wrong one."""

import pytest

from deploy.policy.compatibility import sensors_read
from eval.faults.catalogue import catalogue
from eval.faults.schedule import plan
from eval.soak import cli as command
from eval.soak import options as soak_options
from eval.soak.options import PROFILES, load_profile
from eval.statistics.budget import BUDGET, load_budget
from eval.statistics.evidence import trials_needed
from robots.errors import ConfigError
from robots.randomness import robot_seed
from support.arm6 import SPEC
from support.contracts import arm_contract

GOOD = 'meaning = "mine"\nhours = 1.5\nrobots = 3\nbudget = "mine.toml"\n'
FAULTS = "[faults]\ncoverage = 0.9\ncycle_s = 20.0\noperator_s = 5.0\n"


@pytest.mark.parametrize(
    ("name", "robots", "hours"),
    [
        ("smoke", 32, 0.1),
        ("shift", 32, 8.0),
        ("nightly", 64, 8.0),
        ("faults", 48, 0.9),
        ("weekend", 256, 8.0),
    ],
)
def test_shipped_profiles_match_their_names(name, robots, hours):
    profile, budget = load_profile(name)
    assert (profile.robots, profile.hours) == (robots, hours)
    assert (profile.faults is not None) == (name == "faults")
    load_budget(budget)


def test_the_faults_profile_injects_enough_for_the_coverage_that_it_states():
    profile, _ = load_profile("faults")
    seeds, ticks = [robot_seed(7, 0)], round(profile.hours * 3600 / SPEC.dt)
    read = sensors_read(arm_contract(), SPEC)
    each = len(plan(SPEC, read, profile.faults, seeds, 0, ticks).injections) // len(catalogue(SPEC, read))
    assert each * profile.robots >= trials_needed(profile.faults.coverage) * 1.2  # some find no robot at work


def test_user_profile_finds_its_budget_beside_it(tmp_path):
    (tmp_path / "mine.toml").write_text(BUDGET.read_text())
    path = tmp_path / "own.toml"
    path.write_text(GOOD + FAULTS)
    profile, budget = load_profile(str(path))
    assert (profile.hours, profile.robots, profile.faults.cycle_s) == (1.5, 3, 20.0)
    assert budget == tmp_path / "mine.toml"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (GOOD + "draws = 3\n", r"own\.toml: draws: Extra inputs are not permitted, found 3"),
        (
            GOOD.replace("robots = 3", "robots = 0"),
            r"own\.toml: robots: .* greater than or equal to 1, found 0",
        ),
        (GOOD.replace("robots = 3\n", ""), r"own\.toml: robots: Field required"),
        (GOOD.replace("1.5", "0.0"), r"own\.toml: hours: .* greater than 0, found 0\.0"),
        (GOOD + FAULTS.replace("0.9", "1.0"), r"own\.toml: faults\.coverage: .* less than 1, found 1\.0"),
        (GOOD + FAULTS.replace("20.0", "2.0"), r"own\.toml: faults\.cycle_s: .* equal to 18, found 2\.0"),
        (
            GOOD + FAULTS.replace("20.0", "1e308"),
            r"own\.toml: faults\.cycle_s: .* less than or equal to 36000000, found 1e\+308",
        ),
        (GOOD + FAULTS + "draws = 3\n", r"own\.toml: faults\.draws: Extra inputs"),
        (GOOD + FAULTS.replace("5.0", "nan"), r"own\.toml: faults\.operator_s: .* finite number, found nan"),
        (GOOD + FAULTS + "classes = 3\n", r"own\.toml: faults\.classes: .* valid tuple, found 3"),
        (GOOD + FAULTS + "classes = []\n", r"own\.toml: faults\.classes: .* at least 1 item .*, found \(\)"),
    ],
)
def test_a_wrong_profile_is_named_with_its_field(tmp_path, text, message):
    path = tmp_path / "own.toml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=message):
        load_profile(str(path))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            GOOD + FAULTS + 'classes = ["bus silent", "bus silence"]\n',
            "faults.classes: found 'bus silence', expected some of: encoder off, ",
        ),
        (
            GOOD + FAULTS + 'classes = ["force off"]\n',  # no one reads the arm's force sensor
            "faults.classes: found 'force off', expected some of: encoder off, ",
        ),
        (GOOD.replace("1.5", "0.001") + FAULTS, "hours: found 0.001, expected at least 0.00639: time for"),
        (GOOD.replace("1.5", "60.0") + FAULTS, "hours: found 60.0, expected above 0 and at most 55.556"),
    ],
)
def test_a_profile_that_does_not_fit_is_bad_input_in_one_line(call, arm_policy, tmp_path, text, message):
    path = tmp_path / "own.toml"
    path.write_text(text)
    code, _, said = call(command.cli, "--policy", arm_policy, "--profile", path)
    assert code == 2
    assert f"error: {path}: {message}" in said
    assert said.count("\n") == 1


def asked(call, monkeypatch, *options):
    """Soak that `soak-test` would run with these options, not run, and the text of its errors."""
    seen = {}

    def stop(**what):
        seen.update(what)
        raise ConfigError("enough")

    monkeypatch.setattr(soak_options, "SoakConfig", stop)
    return seen, call(command.cli, *options)[2]


def test_options_override_the_profile(call, arm_policy, monkeypatch):
    policy = ("--policy", arm_policy)
    plain, _ = asked(call, monkeypatch, *policy)
    assert (plain["hours"], plain["robots"], plain["budget"], plain["faults"]) == (8.0, 32, BUDGET, None)
    shift, _ = asked(call, monkeypatch, *policy, "--profile", "shift")
    assert (shift["hours"], shift["robots"], shift["budget"]) == (8.0, 32, BUDGET)
    small = ("--profile", "faults", "--hours", 0.1, "--robots", 8, "--budget", BUDGET)
    short, _ = asked(call, monkeypatch, *policy, *small)
    assert (short["hours"], short["robots"], short["budget"]) == (0.1, 8, BUDGET)
    assert short["faults"] == load_profile("faults")[0].faults


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            ("--profile", "night"),
            "--profile night: found no such profile, expected a file.toml or one of: faults, ",
        ),
        (("--profile", "no.toml"), "no.toml: cannot be read: No such file"),
        (("--profile", "smoke", "--robots", "0"), "--robots: found 0, expected from 1"),
        (
            ("--profile", "faults", "--hours", "0.007"),
            "--hours: found 0.007, expected at least 0.0075: time for one fault",
        ),
        (
            ("--profile", "faults", "--hours", "67"),
            "--hours: found 67.0, expected above 0 and at most 66.668",
        ),
    ],
)
def test_missing_profile_is_reported(call, arm_policy, monkeypatch, options, message):
    seen, said = asked(call, monkeypatch, "--policy", arm_policy, *options)
    assert seen == {}
    assert message in said
    assert len(list(PROFILES.glob("*.toml"))) == 5


def test_a_policy_is_tried_in_a_separate_process_first(arm_policy, crashing_trial, call, tmp_path):
    out = tmp_path / "out"
    code, _, complaint = call(command.cli, "--policy", arm_policy, "--out", out)
    assert (code, complaint) == (2, f"error: {arm_policy}: {crashing_trial}\n")
    assert not out.exists()
