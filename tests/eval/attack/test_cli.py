"""soak-attack and make attack as commands."""

import json
import re
import shutil
import signal
from types import SimpleNamespace

import pytest
from rich.console import Console

pytest.importorskip("mujoco")

import eval.attack.__main__ as suite_command
import eval.attack.cli as command
from deploy.command_line import BUDGET_EXCEEDED, PASSED, main
from deploy.operation.interrupts import interrupt
from deploy.start import BROKEN, INTERRUPTED
from eval.attack import arena
from eval.attack.adversaries import OF_MANY
from eval.attack.attack_folder import FOLDERS, UNFINISHED_FOLDERS
from eval.attack.candidate import read_case
from eval.attack.cli import cli
from eval.attack.suite import OPEN, SUITE, run_suite
from eval.judge.monitors import MONITORS
from eval.replay.bundle_files import INFO
from support.eval.attacks import ShortSetting, planted_workers

OPTIONS = {"--robot": "planar3", "--generations": 2, "--workers": 1}


def attack(call, out, **options):
    given = OPTIONS | {"--out": out} | {f"--{name}": value for name, value in options.items()}
    return call(cli, *(word for pair in given.items() for word in pair))


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ({"robot": "nobody"}, "nobody"),
        ({"mode": "thought"}, "--mode: found 'thought', expected one of those of planar3: position"),
        ({"seed": -1}, "--seed: found -1, expected from 0 to 9223372036854775807"),
        ({"workers": 0}, "--workers: found 0, expected from 1 to 1024"),
        ({"minutes": 0}, "--minutes: found 0.0, expected above 0, at most 1e+06"),
        ({"generations": 0}, "--generations: found 0, expected at least 1"),
        ({"seed": "x"}, "'--seed'"),
        ({"minutes": "nan"}, "--minutes: found nan, expected above 0"),
        ({"minutes": 3e306}, "--minutes: found 3e+306, expected above 0, at most 1e+06"),
        ({"fault": "bad luck"}, "--fault: found 'bad luck', expected some of: encoder off"),
        (
            {"gains": "nothing.onnx"},
            "--gains: found 'nothing.onnx', expected softest, stiffest or the file of a policy",
        ),
        ({"without": "no such"}, "--without 'no such': found 0 such guards"),
        ({"without": "take_over"}, "--without 'take_over': found 0 such guards"),
        ({"without": "safety: tool speed, off"}, "found a guard of the monitor tool_speed, expected one of"),
        ({"without": "drives of a stop"}, "found a guard of torque mode, expected one of position mode"),
    ],
)
def test_wrong_option_is_named(options, complaint, call, tmp_path):
    code, _, error = attack(call, tmp_path, **options)
    assert code == 2
    assert complaint in error


@pytest.mark.parametrize(("ratio", "code"), [(0.9, PASSED), (1.1, BUDGET_EXCEEDED)])
def test_a_hard_event_fails_the_command_and_all_monitors_are_reported(
    ratio, code, call, tmp_path, monkeypatch
):
    monkeypatch.setattr(command, "workers", planted_workers("planar3", velocity=ratio))
    tmp_path /= "a[/x]"
    found, said, _ = attack(call, tmp_path)
    assert found == code
    assert f"report: {tmp_path / 'attack.json'}" in said
    assert ("hard events: velocity" in said) == (code == BUDGET_EXCEEDED)
    report = json.loads((tmp_path / "attack.json").read_text())
    rows = {row["monitor"]: row for row in report["rows"]}
    assert rows["velocity"]["worst"] == ratio
    assert rows["velocity"]["margin"] == pytest.approx(1 - ratio)
    assert rows["velocity"]["bundle"] == "bundle-of-velocity"
    assert (rows["position_requested"]["hard"], rows["position_requested"]["bundle"]) == (False, "")
    assert rows["action_finite"]["exempt"]
    case = read_case(tmp_path / "cases" / "planar3-position-velocity.json")
    assert (case.monitor, case.robot, case.worst) == ("velocity", "planar3", ratio)


def test_what_the_policy_says_itself_fails_nothing(call, tmp_path, monkeypatch):
    monkeypatch.setattr(command, "workers", planted_workers("planar3", action_finite=2.0))
    assert attack(call, tmp_path)[0] == PASSED


def test_without_a_guard_the_search_ends_at_the_first_event_of_its_monitor(call, tmp_path, monkeypatch):
    monkeypatch.setattr(command, "workers", planted_workers("planar3", velocity=1.2))
    code, *_ = attack(call, tmp_path, without="safety: velocity, off", generations=100)
    report = json.loads((tmp_path / "attack.json").read_text())
    assert code == BUDGET_EXCEEDED
    assert report["without"] == "safety: velocity, off"
    assert report["trials"] == (len(OF_MANY) + 2) * 16, "the library, and the two arms of this monitor"
    assert not (tmp_path / "cases").exists()


SIGNALS = pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])


@SIGNALS
def test_interrupted_attack_reports_what_it_tried(number, call, tmp_path, monkeypatch):
    generations = iter(range(3))

    def interrupt(blocks):
        if next(generations) == 2:
            signal.raise_signal(number)

    monkeypatch.setattr(command, "workers", planted_workers("planar3", before=interrupt))
    code, said, _ = attack(call, tmp_path, generations=100)
    assert code == INTERRUPTED
    assert "interrupted: the report covers" in said
    place = tmp_path / "unfinished"
    assert f"report: {place / 'attack.json'}" in said
    assert json.loads((place / "attack.json").read_text())["trials"] > (len(OF_MANY) + 5) * 16
    assert read_case(place / "cases" / "planar3-position-velocity.json").monitor == "velocity"


@pytest.mark.parametrize("when", ["before", "after"])
def test_interrupted_attack_replaces_nothing_of_a_finished_one(when, call, tmp_path, monkeypatch):
    """Be it interrupted while it searches or while it writes bundles; the next that finishes replaces both."""
    calls = iter(range(99))

    def interrupt(_):
        if next(calls) == 1:
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(command, "workers", planted_workers("planar3", velocity=0.7))
    assert attack(call, tmp_path)[0] == PASSED
    finished = contents(tmp_path)
    monkeypatch.setattr(command, "workers", planted_workers("planar3", velocity=0.6, **{when: interrupt}))
    assert attack(call, tmp_path)[0] == INTERRUPTED
    found = contents(tmp_path)
    assert {path: found[path] for path in finished} == finished
    assert {path.parts[0] for path in found.keys() - finished.keys()} == {"unfinished"}
    monkeypatch.setattr(command, "workers", planted_workers("planar3", velocity=0.8))
    assert attack(call, tmp_path)[0] == PASSED
    assert {path.parts[0] for path in contents(tmp_path)} == {"attack.json", "cases", "worst"}
    assert read_case(tmp_path / "cases" / "planar3-position-velocity.json").worst == 0.8


def test_an_attack_that_tried_nothing_leaves_an_earlier_one_that_has_not_finished(
    call, tmp_path, monkeypatch
):
    """Each is interrupted, the second before its first result."""
    generations = iter(range(9))

    def interrupt(_):
        if next(generations) != 0:
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(command, "workers", planted_workers("planar3", before=interrupt))
    assert attack(call, tmp_path)[0] == INTERRUPTED
    earlier = contents(tmp_path)
    assert {path.parts[0] for path in earlier} == {"unfinished"}
    assert attack(call, tmp_path)[0] == INTERRUPTED
    assert contents(tmp_path) == earlier


def contents(folder):
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@SIGNALS
def test_attack_interrupted_while_bundles_are_written_reports_those_that_are(
    number, call, tmp_path, monkeypatch
):
    written = []

    def interrupt(name):
        written.append(name)
        if len(written) == 2:
            signal.raise_signal(number)

    monkeypatch.setattr(command, "workers", planted_workers("planar3", after=interrupt))
    code, said, _ = attack(call, tmp_path)
    assert code == INTERRUPTED
    assert "interrupted: the report covers the bundles written so far" in said
    rows = json.loads((tmp_path / "unfinished" / "attack.json").read_text())["rows"]
    assert {row["monitor"] for row in rows if row["bundle"]} == set(written)
    assert {folder.name for folder in (tmp_path / "unfinished" / "worst").iterdir()} == {
        f"bundle-of-{n}" for n in written
    }


def test_an_attack_prints_where_signals_end_it(call, tmp_path, monkeypatch):
    """Printing may block until somebody reads the output; the table is printed once all files are complete."""
    handlers, there = [], []

    class Observed(Console):
        def print(self, *text, **how):
            handlers.append(signal.getsignal(signal.SIGTERM))
            there.append({path.name for path in tmp_path.iterdir()})
            super().print(*text, **how)

    monkeypatch.setattr(command, "plain_console", Observed)
    monkeypatch.setattr(command, "workers", planted_workers("planar3"))
    assert attack(call, tmp_path)[0] == PASSED
    assert set(handlers) == {interrupt}
    assert there[-2:] == [{"attack.json", "cases", "worst"}] * 2


def test_bundles_of_an_earlier_attack_stay_until_there_are_others(call, tmp_path, monkeypatch):
    old = tmp_path / "worst" / "old"
    old.mkdir(parents=True)
    (old / INFO).touch()

    def fail(blocks):
        assert old.exists()
        raise RuntimeError("no power")

    monkeypatch.setattr(command, "workers", planted_workers("planar3", before=fail))
    assert attack(call, tmp_path)[0] == BROKEN
    assert old.exists()
    monkeypatch.setattr(command, "workers", planted_workers("planar3"))
    assert attack(call, tmp_path)[0] == PASSED
    assert not old.exists()


def test_a_bundle_that_fails_loses_no_report(call, tmp_path, monkeypatch):
    written = []

    def fail(name):
        written.append(name)
        if len(written) == 3:
            raise RuntimeError("ticks differ")

    monkeypatch.setattr(command, "workers", planted_workers("planar3", after=fail, velocity=0.8))
    code, _, error = attack(call, tmp_path)
    assert code == BROKEN
    assert "ticks differ" in error
    report = json.loads((tmp_path / "unfinished" / "attack.json").read_text())
    (row,) = (row for row in report["rows"] if row["monitor"] == "velocity")
    assert row["worst"] == 0.8
    bundles = {row["bundle"] for row in report["rows"] if row["bundle"]}
    assert bundles == {folder.name for folder in (tmp_path / "unfinished" / "worst").iterdir()}
    assert bundles == {f"bundle-of-{name}" for name in written}


def test_a_folder_in_place_of_a_case_is_an_error_before_the_search(call, tmp_path, monkeypatch):
    monkeypatch.setattr(command, "workers", None)
    (tmp_path / "attack.json").write_text("{}")
    case = tmp_path / "cases" / "planar3-position-velocity.json"
    case.mkdir(parents=True)
    code, _, error = attack(call, tmp_path)
    assert code == 2
    assert error == f"error: --out {case}: found a folder, expected a file or nothing\n"


def test_files_of_others_stay(call, tmp_path, monkeypatch):
    monkeypatch.setattr(command, "workers", planted_workers("planar3"))
    cases = tmp_path / "cases"
    cases.mkdir()
    own, other = cases / "planar3-position-velocity.json", cases / "arm6-position-velocity.json"
    (cases / "mine.json").mkdir()
    own.write_text("{}")
    code, _, error = attack(call, tmp_path)
    assert (code, own.read_text()) == (2, "{}")
    assert "found cases/ without attack.json, expected a folder of an attack, or a new one" in error
    (tmp_path / "attack.json").touch()
    other.touch()
    assert attack(call, tmp_path)[0] == PASSED
    assert own.read_text() != "{}"
    assert other.exists()


def test_a_case_that_cannot_be_replaced_after_the_search_is_named(call, tmp_path, monkeypatch):
    planted, case = planted_workers("planar3"), tmp_path / "cases" / "planar3-position-velocity.json"

    def in_the_way(*arguments):
        case.mkdir(parents=True)
        return planted(*arguments)

    monkeypatch.setattr(command, "workers", in_the_way)
    code, _, error = attack(call, tmp_path)
    assert (code, error) == (
        1,
        f"error: not kept: --out {case}: found a folder or a device, expected a file or nothing\n"
        f"the report is in {tmp_path / 'unfinished'}\n",
    )
    assert (tmp_path / "unfinished" / "attack.json").exists()
    assert not (tmp_path / "attack.json").exists()


def test_a_file_in_the_place_of_the_cases_is_named_before_the_search(call, tmp_path):
    (tmp_path / "cases").touch()
    code, _, error = attack(call, tmp_path)
    assert (code, error) == (
        2,
        f"error: --out {tmp_path / 'cases'}: cannot be written: File exists, expected a folder\n",
    )


@pytest.mark.parametrize("begun", [False, True])
@pytest.mark.parametrize("name", FOLDERS)
def test_behind_a_link_nothing_changes(name, begun, call, tmp_path, monkeypatch):
    """Be it there from the beginning, or made during the search."""
    theirs, out = tmp_path / "theirs", tmp_path / "out"
    files = {theirs / "b" / INFO, theirs / "planar3-position-velocity.json"}
    for path in files:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("theirs")
    out.mkdir()
    (out / "attack.json").touch()

    def link(_=None):
        if not (out / name).exists():
            (out / name).parent.mkdir(exist_ok=True)
            (out / name).symlink_to(theirs)

    def search(blocks):
        link()
        assert begun

    if not begun:
        link()
    monkeypatch.setattr(command, "workers", planted_workers("planar3", before=search))
    code, _, error = attack(call, out)
    said = f"--out {out / name}: found a link, expected no link"
    lost = begun and name not in UNFINISHED_FOLDERS
    assert (code, error) == (
        (1, f"error: not kept: {said}\nthe report is in {out / 'unfinished'}\n")
        if lost
        else (2, f"error: {said}\n")
    )
    assert (out / "unfinished" / "attack.json").exists() == lost
    assert {path for path in theirs.rglob("*") if path.is_file()} >= files
    assert {path.read_text() for path in files} == {"theirs"}


@pytest.mark.slow
def test_results_do_not_depend_on_the_number_of_workers(call, tmp_path, monkeypatch):
    """With two adversaries and two pushed arms, tried for a second, and bundles of two monitors."""
    monkeypatch.setattr(command, "Setting", ShortSetting)
    others = {monitor.name for monitor in MONITORS} - {"velocity", "torque"}
    monkeypatch.setattr("eval.attack.archive.EXEMPT", others)
    monkeypatch.setattr("eval.attack.search.OF_MANY", OF_MANY[:2])
    for workers in (1, 2):
        out = tmp_path / str(workers)
        assert attack(call, out, workers=workers, generations=1)[0] in (PASSED, BUDGET_EXCEEDED)
    first, second = (json.loads((tmp_path / name / "attack.json").read_text()) for name in "12")
    assert first == second
    bundles = {row["bundle"] for row in first["rows"]} - {""}
    assert bundles
    assert {path.name for path in (tmp_path / "1" / "worst").iterdir()} == bundles


def make_attack(call, cases):
    return call(lambda: main(suite_command.attack), "--cases", cases)


@pytest.mark.slow
def test_guards_hold_against_all_that_attacks_have_found(call):
    code, said, _ = make_attack(call, SUITE)
    assert (code, said.count("hard events: 0\n")) == (PASSED, len(list(SUITE.glob("*.json"))))


@pytest.mark.slow
def test_open_cases_still_lead_to_their_events(call, monkeypatch):
    """One that no longer does is fixed, and belongs to the suite. They do within a second, or 5 s with a fault."""
    monkeypatch.setattr(arena, "EPISODE_S", 1.0)
    monkeypatch.setattr(arena, "FAULTY_EPISODE_S", 5.0)
    results = list(run_suite(OPEN))
    for result in results:
        assert result.case.monitor in result.events
    monkeypatch.setattr(suite_command, "run_suite", lambda folder: results)
    assert make_attack(call, OPEN)[0] == BUDGET_EXCEEDED


def test_make_attack_in_short_tries_cases_of_each_mode(call, tmp_path, monkeypatch):
    """Half a second of operation of one case in each mode."""
    monkeypatch.setattr(arena, "EPISODE_S", 0.75)
    for mode in ("position", "velocity", "torque"):
        shutil.copy(sorted(SUITE.glob(f"arm6-{mode}-*.json"))[0], tmp_path)
    code, said, _ = make_attack(call, tmp_path)
    assert (code, said.count("hard events: 0\n")) == (PASSED, 3)
    assert "0 of 3 cases failed" in said


def test_suite_is_small():
    assert sum(path.stat().st_size for path in SUITE.rglob("*.json")) < 200_000


@pytest.mark.parametrize(("events", "code"), [((), PASSED), (("torque",), BUDGET_EXCEEDED)])
def test_make_attack_fails_where_a_case_fails(events, code, call, monkeypatch):
    (path, *_) = sorted(SUITE.glob("*.json"))
    tried = SimpleNamespace(case=read_case(path), path=path, events=events, worst=lambda monitor: 0.5)
    monkeypatch.setattr(suite_command, "run_suite", lambda folder: [tried])
    found, said, _ = make_attack(call, SUITE)
    assert found == code
    assert f"{len(events)} of 1 cases failed" in said


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (None, "found no case"),
        ({"robot": "nobody"}, r"a\.json: robot: .*nobody"),
        ({"monitor": "fallen"}, r"a\.json: monitor: found fallen, expected one of position_requested"),
        ({"robot": "quadruped", "mode": "torque"}, r"a\.json: mode: found torque"),
        ({"weights": {}}, r"a\.json: weights: found '', expected "),
        ({"seed": "seven"}, r"a\.json: seed: "),
    ],
)
def test_make_attack_names_what_is_wrong_with_a_case(change, complaint, call, tmp_path):
    if change:
        (path, *_) = sorted(SUITE.glob("*.json"))
        (tmp_path / "a.json").write_text(json.dumps(read_case(path).model_dump() | change))
    code, _, error = make_attack(call, tmp_path)
    assert code == 2
    assert re.search(complaint, error)
    assert error.count("\n") == 1


def test_make_attack_refuses_a_folder_that_is_not_there(call, tmp_path):
    for name in ("nowhere", "x" * 300):
        code, _, error = make_attack(call, tmp_path / name)
        assert code == 2
        assert f"{name}: found no case" in error
