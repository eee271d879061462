"""A history of nights: kept whole, never overwritten, and refused if it is not what was kept."""

import errno
import json
import os

import pytest

from eval.history.history import CHARACTERS_MAX, SUFFIX, add_record, read_history, read_record
from eval.history.soak_record import SoakRecord
from eval.report.report_files import write_report
from eval.report.schema.report_data import Report
from eval.report.sections.trend import trend
from eval.soak import cli as command
from eval.statistics.per_draw_counts import COUNT_MAX, DT_MIN, concatenate
from robots.errors import ConfigError, OutputError
from support.eval.nights import LATER, OTHER, SETTINGS, night
from support.eval.reports import report


def test_stored_night_is_read_back_unchanged(tmp_path):
    kept = night(7)
    path = add_record(kept, tmp_path / "new" / "history")
    assert path.name == "20260102T210000Z-seed7.soak.json"
    assert read_record(path) == kept
    assert read_history(path.parent) == {str(path): kept}
    assert [file.name for file in path.parent.iterdir()] == [path.name]


def test_only_the_night_of_a_report_is_stored(tmp_path):
    whole = report(["jerk"])
    found = read_record(add_record(whole, tmp_path))
    assert type(found) is SoakRecord
    assert found.model_dump() == whole.model_dump(include={*SoakRecord.model_fields})
    assert (sum(found.per_draw_counts.hard["jerk"]), found.per_draw_counts.bad_draws) == (1, 1)
    assert found.per_draw_counts.hottest_c == (65.0,) * 5 + (80.0,) + (65.0,) * 10


def test_report_and_its_folder_are_read_as_nights(tmp_path):
    whole = report()
    write_report(whole, tmp_path)
    assert read_record(tmp_path, Report) == read_record(tmp_path / "report.json", Report) == whole
    assert type(read_record(tmp_path, Report)) is Report


def test_nothing_is_overwritten_and_nights_are_ordered_by_time(tmp_path):
    later = add_record(night(9, started=LATER), tmp_path)
    paths = [add_record(night(7), tmp_path) for _ in range(3)]
    assert [path.name.removesuffix(SUFFIX)[-7:] for path in paths] == ["Z-seed7", "seed7-2", "seed7-3"]
    assert list(read_history(tmp_path))[-1] == str(later)
    assert len(read_history(tmp_path)) == 4


@pytest.mark.parametrize(
    ("bound", "most", "found"),
    [
        ("RECORDS_MAX", 2, "3 records"),
        ("BYTES_MAX", 1000, r"\d+ bytes of records"),
        ("DRAWS_MAX", 47, "48 draws"),
    ],
)
def test_a_history_that_is_too_large_is_refused(bound, most, found, tmp_path, monkeypatch):
    for seed in (7, 8, 9):
        add_record(night(seed), tmp_path)
    monkeypatch.setattr(f"eval.history.history.{bound}", most)
    with pytest.raises(ConfigError, match=rf"{tmp_path}: found {found}, expected at most {most}: move old"):
        read_history(tmp_path)


def test_two_soaks_that_finish_together_are_both_kept(tmp_path, monkeypatch):
    """The other one takes the name at the last moment."""

    def late(*paths):
        monkeypatch.undo()
        add_record(night(7), tmp_path)
        os.link(*paths)

    monkeypatch.setattr(os, "link", late)
    path = add_record(night(7), tmp_path)
    assert path.name.removesuffix(SUFFIX)[-7:] == "seed7-2"
    assert len(os.listdir(tmp_path)) == len(read_history(tmp_path)) == 2


def test_file_system_without_hard_links_keeps_nights(tmp_path, monkeypatch):
    def refuse(*_):
        raise PermissionError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(os, "link", refuse)
    paths = [add_record(night(7), tmp_path) for _ in range(2)]
    assert list(read_history(tmp_path)) == [str(path) for path in reversed(paths)]
    assert len(os.listdir(tmp_path)) == 2


def test_same_moment_in_another_time_zone_is_not_later(tmp_path):
    first = add_record(night(1, started="2026-01-02T23:30:00+02:00"), tmp_path)
    second = add_record(night(2, started="2026-01-02T21:45:00+00:00"), tmp_path)
    assert list(read_history(tmp_path)) == [str(first), str(second)]


def test_leftovers_and_other_files_are_ignored(tmp_path):
    path = add_record(night(7), tmp_path)
    path.with_name(f".1234abcd.{path.name}").write_text('{"format": 1, "res')
    (tmp_path / "report.json").write_text("{}")
    (tmp_path / "trend.html").write_text("")
    assert list(read_history(tmp_path)) == [str(path)]
    assert read_history(tmp_path / "nowhere") == {}


def edited(path, change):
    data = json.loads(path.read_text())
    change(data)
    path.write_text(json.dumps(data))


def hide(data):
    data["per_draw_counts"]["hard"]["jerk"][3] += 1


SPOILT = {
    "cut": (lambda path: path.write_text(path.read_text()[:500]), "not valid JSON"),
    "empty": (lambda path: path.write_text(""), "not valid JSON"),
    "no text": (lambda path: path.write_bytes(b"\xff\xfe\x00"), "not valid UTF-8"),
    "a list": (lambda path: path.write_text("[7]"), "whole file"),
    "a count": (lambda path: edited(path, hide), "results_digest: found .*, expected .*: edited"),
    "a verdict": (lambda path: edited(path, lambda d: d.update(verdict="failed")), "results_digest: found"),
    "a seed": (lambda path: edited(path, lambda d: d["settings"].update(seed=8)), "results_digest: found"),
    "a policy": (
        lambda path: edited(path, lambda d: d["settings"].update(policy_digest="z9")),
        "results_digest: found",
    ),
    "faults": (
        lambda path: edited(path, lambda d: d["settings"].update(faults={"coverage": 0.9})),
        r"settings\.faults\.cycle_s: Field required",
    ),
    "unsealed": (
        lambda path: edited(path, lambda d: d.pop("results_digest")),
        "results_digest: found , expected",
    ),
    "a negative": (
        lambda path: edited(path, lambda d: d["per_draw_counts"]["stops"].__setitem__(0, -1)),
        r"per_draw_counts\.stops\.0: .* found -1",
    ),
    "a huge count": (
        lambda path: edited(path, lambda d: d["per_draw_counts"]["hard"]["jerk"].__setitem__(3, 2**63)),
        r"per_draw_counts\.hard\.jerk\.3: .* less than or equal to 1099511627776, found 9223372036854775808",
    ),
    "no number": (
        lambda path: edited(path, lambda d: d["per_draw_counts"].update(dt=float("nan"))),
        r"per_draw_counts\.dt: .* found nan",
    ),
    "a missing key": (
        lambda path: edited(path, lambda d: d["per_draw_counts"].pop("due")),
        r"per_draw_counts\.due: Field required",
    ),
    "an unknown key": (
        lambda path: edited(path, lambda d: d.update(note="mine")),
        "note: Extra inputs[^\n]*$",
    ),
    "a format": (lambda path: edited(path, lambda d: d.update(format=1)), "format: .* found 1"),
    "how much": (lambda path: edited(path, lambda d: d["run"].update(hours=9.0)), "results_digest: found"),
    "robots": (lambda path: edited(path, lambda d: d["settings"].update(robots=8)), "results_digest: found"),
    "no time": (
        lambda path: edited(path, lambda d: d["run"].update(started="yesterday")),
        r"run\.started: .* found 'yesterday'",
    ),
    "no zone": (
        lambda path: edited(path, lambda d: d["run"].update(started="2026-01-02T22:00:00")),
        r"run\.started: expected a time with its zone",
    ),
    "a letter after the date": (
        lambda path: edited(path, lambda d: d["run"].update(started="20260102\x1b2200+0100")),
        r"run\.started: expected 2026-01-02T22:00:00\+01:00, found '20260102\\x1b2200\+0100'",
    ),
    "a letter before the zone": (
        lambda path: edited(path, lambda d: d["run"].update(started="2026-01-02T22:00\x1b+01:00")),
        r"run\.started: expected 2026-01-02T22:00:00\+01:00",
    ),
    "a tiny period": (
        lambda path: edited(path, lambda d: d["per_draw_counts"].update(dt=5e-324)),
        r"per_draw_counts\.dt: .* greater than or equal to 0\.000001, found 5e-324",
    ),
    "a heat beyond any": (
        lambda path: edited(path, lambda d: d["per_draw_counts"]["hottest_c"].__setitem__(2, 1.7e308)),
        r"per_draw_counts\.hottest_c\.2: .* less than or equal to 100000, found 1\.7e\+308",
    ),
    "a cold beyond any": (
        lambda path: edited(path, lambda d: d["per_draw_counts"]["hottest_c"].__setitem__(2, -274)),
        r"per_draw_counts\.hottest_c\.2: .* greater than or equal to -273\.15, found -274",
    ),
}


@pytest.mark.parametrize(("spoil", "said"), SPOILT.values(), ids=SPOILT)
def test_changed_night_is_refused_by_file_and_field(tmp_path, spoil, said):
    add_record(night(1), tmp_path)
    path = add_record(night(7, started=LATER), tmp_path)
    spoil(path)
    with pytest.raises(ConfigError, match=rf"seed7\.soak\.json: .*{said}"):
        read_history(tmp_path)


@pytest.mark.parametrize(("part", "whole"), [("running", "ticks"), ("reached", "due")])
def test_more_than_all_is_refused(tmp_path, part, whole):
    """Even with the right digest, which anybody can compute."""
    kept = night(7)
    most = getattr(kept.per_draw_counts, whole)
    too_many = (*most[:3], most[3] + 1, *most[4:])
    counts = kept.per_draw_counts.model_copy(update={part: too_many})
    forged = kept.model_copy(update={"per_draw_counts": counts})
    path = add_record(forged.model_copy(update={"results_digest": forged.sealed()}), tmp_path)
    with pytest.raises(ConfigError) as caught:
        read_record(path)
    said = f"per_draw_counts.{part}.3: found {most[3] + 1}, expected at most {most[3]}, its {whole}"
    assert str(caught.value) == f"{path}: {said}"


@pytest.mark.parametrize("dt", [DT_MIN, 1.0])
def test_the_highest_counts_have_a_trend(dt):
    whole = night(7)
    highest = dict.fromkeys(whole.per_draw_counts.hard, (COUNT_MAX,) * whole.settings.robots)
    counts = whole.per_draw_counts.model_copy(update={"hard": highest, "dt": dt})
    found = trend({"a.json": whole.model_copy(update={"per_draw_counts": counts})})
    assert found.last.hard_events == len(highest) * whole.settings.robots * COUNT_MAX


def test_no_soak_has_a_record_that_is_too_long_to_read(tmp_path):
    counts = night(1).per_draw_counts
    many = concatenate([counts] * -(-100_000 // counts.draws))  # as many robots as a soak may have
    path = add_record(night(1).model_copy(update={"per_draw_counts": many}), tmp_path)
    assert path.stat().st_size < CHARACTERS_MAX <= 1 << 26


def test_a_file_of_empty_objects_is_no_record(tmp_path):
    (tmp_path / f"a{SUFFIX}").write_text("[" + "{}," * 200_000 + "{}]")
    with pytest.raises(
        ConfigError, match=r"a\.soak\.json: found 200002 lists and objects of JSON, expected at"
    ):
        read_history(tmp_path)


def test_unreadable_file_is_reported(tmp_path):
    (tmp_path / f"a{SUFFIX}").symlink_to(tmp_path / "gone")
    with pytest.raises(ConfigError, match=r"a\.soak\.json: cannot be read: No such file"):
        read_history(tmp_path)
    with pytest.raises(ConfigError, match=r"report\.json: cannot be read: No such file"):
        read_record(tmp_path)


def test_unfinished_soak_is_not_a_night(tmp_path):
    write_report(report(interrupted=True), tmp_path)
    with pytest.raises(
        ConfigError, match=r"report\.json: run\.interrupted: found true, expected a finished soak"
    ):
        read_record(tmp_path, Report)
    edited(tmp_path / "report.json", lambda data: data["run"].update(interrupted=False))
    with pytest.raises(ConfigError, match=r"report\.json: results_digest: found"):
        read_record(tmp_path, Report)


@pytest.mark.parametrize("key", SETTINGS.task)
def test_nights_of_another_task_are_refused_by_file_and_field(tmp_path, key):
    first = add_record(night(1), tmp_path)
    odd = add_record(night(2, started=LATER, **OTHER[key]), tmp_path)
    with pytest.raises(ConfigError) as caught:
        read_history(tmp_path)
    found, expected = (read_record(path).settings.task[key] for path in (odd, first))
    assert str(caught.value) == f"{odd}: {key}: found {found}, but {first} has {expected}"


@pytest.mark.parametrize("key", sorted(SETTINGS.identity.keys() - SETTINGS.task.keys()))
def test_object_under_test_may_change(tmp_path, key):
    add_record(night(1), tmp_path)
    add_record(night(2, started=LATER, **OTHER[key]), tmp_path)
    assert len(read_history(tmp_path)) == 2


def test_a_full_disk_leaves_no_part_of_a_night(tmp_path, monkeypatch):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pathlib.Path.write_text", full)
    with pytest.raises(
        OutputError, match=r"^--history .*seed7\.soak\.json: cannot be written: No space left"
    ):
        add_record(night(7), tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_soak_is_stored_and_shown_with_earlier_nights(call, arm_policy, tmp_path):
    """Four and a half seconds of eight idle arms; then the same of half the hours, which is another task."""
    history, out = tmp_path / "history", tmp_path / "out"
    asked = ("--policy", arm_policy, "--robots", 8, "--workers", 1, "--out", out, "--history", history)
    code, said, _ = call(command.cli, *asked, "--hours", 0.00125)
    assert code == 1
    whole = Report.model_validate_json((out / "report.json").read_text())
    (path, kept), *_ = read_history(history).items()
    assert kept.model_dump() == whole.model_dump(include={*SoakRecord.model_fields})
    assert (kept.per_draw_counts.draws, sum(kept.per_draw_counts.ticks)) == (8, 8 * 900)
    assert sum(kept.per_draw_counts.due) == whole.goals.due
    (row,) = whole.trend.runs
    assert (row.hard_events, row.draws, row.goals.value) == (0, 8, whole.goals.success)
    assert "Trend over earlier soaks" in (out / "report.html").read_text()
    assert f"\npooled with earlier soaks: {whole.trend.last.statement}\nreport: " in said
    before = (out / "report.json").read_bytes()
    code, _, said = call(command.cli, *asked, "--hours", 0.000625)
    assert code == 2
    assert f"{path}: hours: found 0.00125, but this soak has 0.000625" in said
    assert (out / "report.json").read_bytes() == before
    assert len(list(history.iterdir())) == 1


@pytest.mark.parametrize("place", ["file", "file/below", "/dev/null/history"])
def test_unwritable_history_is_an_error_before_the_soak(call, arm_policy, tmp_path, place):
    (tmp_path / "file").write_text("mine")
    history = tmp_path / place
    asked = ("--policy", arm_policy, "--hours", 100, "--out", tmp_path / "out", "--history", history)
    code, _, said = call(command.cli, *asked)
    assert code == 2
    assert f"error: --history {history}" in said
    assert list((tmp_path / "out").iterdir()) == []
    assert (tmp_path / "file").read_text() == "mine"
