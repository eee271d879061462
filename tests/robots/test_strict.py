import json
import sys
from typing import Annotated

import pytest
from pydantic import Field, PositiveFloat, PositiveInt, ValidationError

from deploy.command_line import exit_code_of
from deploy.start import BAD_INPUT
from robots.errors import ConfigError, FirstshiftError, RobotError
from robots.strict import KEYS_MAX, Many, Strict, parse, read_json, read_toml


class Leg(Strict):
    length: PositiveFloat
    name: str = "leg"


class Animal(Strict):
    legs: tuple[Leg, ...]
    eyes: PositiveInt
    tame: bool = False
    places: tuple[float, float] = (0.0, 1.0)
    teeth: Annotated[tuple[PositiveFloat, ...], Field(min_length=1)] = (1.0,)
    parts: dict[str, Leg] = Field(default_factory=dict)


class Jaw(Strict):
    teeth: Annotated[tuple[PositiveFloat, ...], Field(min_length=1)]


class Jaws(Strict):
    jaws: tuple[Jaw, ...]


GOOD = "eyes = 2\nlegs = [{ length = 1.5 }, { length = 2, name = 'left' }]\n"


def read(tmp_path, text, error=ConfigError):
    path = tmp_path / "animal.toml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_toml(path, Animal, error)


def test_valid_file_is_read(tmp_path):
    animal = read(tmp_path, GOOD + "places = [3, 4.5]\n[parts.tail]\nlength = 1")
    assert [leg.length for leg in animal.legs] == [1.5, 2.0]
    assert (animal.eyes, animal.places, animal.parts["tail"].length) == (2, (3.0, 4.5), 1.0)
    assert isinstance(animal.legs[1].length, float)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (GOOD + "wings = 2", ["wings", "Extra inputs", "2"]),
        ("legs = []", ["eyes", "required"]),
        (GOOD.replace("length = 1.5", "length = -1.5"), ["legs.0.length", "greater than 0", "-1.5"]),
        (GOOD.replace("length = 1.5", "length = nan"), ["legs.0.length", "nan"]),
        (GOOD.replace("length = 1.5", "length = inf"), ["legs.0.length", "inf"]),
        (GOOD.replace("length = 1.5", "length = '1.5'"), ["legs.0.length", "number", "'1.5'"]),
        (GOOD.replace("length = 1.5", "length = true"), ["legs.0.length", "number", "True"]),
        (GOOD.replace("eyes = 2", "eyes = 2.0"), ["eyes", "integer", "2.0"]),
        (GOOD.replace("eyes = 2", "eyes = '2'"), ["eyes", "integer", "'2'"]),
        (GOOD.replace("eyes = 2", "eyes = true"), ["eyes", "integer", "True"]),
        (GOOD.replace("eyes = 2", "eyes = 0"), ["eyes", "greater than 0", "0"]),
        (GOOD.replace("'left'", "7"), ["legs.1.name", "string", "7"]),
        (GOOD + "tame = 'yes'", ["tame", "boolean", "yes"]),
        (GOOD + "tame = 1", ["tame", "boolean", "1"]),
        (GOOD + "places = [1.0]", ["places"]),
        (GOOD + "places = 3.0", ["places", "3.0"]),
        (GOOD + "parts = [1]", ["parts"]),
        (GOOD + "[parts.tail]\nlength = 0", ["parts.tail.length", "greater than 0"]),
        ("legs = {}\neyes = 2", ["legs"]),
        ("legs = [3]\neyes = 2", ["legs.0", "3"]),
        ("eyes = = 2", ["not valid TOML"]),
        ("eyes = 2\neyes = 3", ["not valid TOML"]),
        (b"\xff\xfe", ["not valid UTF-8"]),
    ],
)
def test_errors_name_the_field_and_value(tmp_path, text, words):
    with pytest.raises(ConfigError) as caught:
        read(tmp_path, text)
    message = str(caught.value)
    assert message.startswith(str(tmp_path / "animal.toml"))
    for word in words:
        assert word in message


def test_every_wrong_field_has_its_own_line(tmp_path):
    with pytest.raises(ConfigError) as caught:
        read(tmp_path, "eyes = -1\nwings = 2\nlegs = [{ length = 0 }, { length = 'x' }]")
    lines = str(caught.value).splitlines()
    assert len(lines) == 4
    assert all(line.startswith(str(tmp_path)) for line in lines)


def test_wrong_items_of_a_list_are_not_called_missing(tmp_path):
    with pytest.raises(ConfigError) as caught:
        read(tmp_path, GOOD + "teeth = [0.0, -1.0]")
    assert [line.split(": ")[1] for line in str(caught.value).splitlines()] == ["teeth.0", "teeth.1"]
    with pytest.raises(ConfigError, match=r"teeth: Tuple should have at least 1 item"):
        read(tmp_path, GOOD + "teeth = []")


def test_the_first_wrong_fields_are_named_and_the_others_counted(tmp_path):
    """Each table lacks a length, and has one key too many."""
    for tables, more in ((10, []), (2000, ["… and 3,980 more"])):
        with pytest.raises(ConfigError) as caught:
            read(tmp_path, GOOD + "".join(f"[parts.p{k}]\nwings = 2\n" for k in range(tables)))
        source = f"{tmp_path / 'animal.toml'}: "
        lines = [line.removeprefix(source) for line in str(caught.value).split("\n")]
        wrong = ["length: Field required", "wings: Extra inputs are not permitted, found 2"]
        assert lines == [f"parts.p{k}.{each}" for k in range(10) for each in wrong] + more


def test_of_very_many_wrong_fields_none_is_named(tmp_path):
    """To put them in words would take a kilobyte for each."""
    with pytest.raises(ConfigError, match="… and 9,980 more"):
        read(tmp_path, GOOD + "".join(f"x{k} = 1\n" for k in range(10_000)))
    with pytest.raises(
        ConfigError, match=r"animal\.toml: found 10,001 wrong fields, more than 10,000, expected none$"
    ):
        read(tmp_path, GOOD + "".join(f"x{k} = 1\n" for k in range(10_001)))


def test_of_a_long_list_the_first_wrong_item_is_named():
    class Nights(Strict):
        hours: Many[Many[float]]

    with pytest.raises(ConfigError, match=r"^here: hours\.1\.0: Input should be a valid number, found 'x'$"):
        parse({"hours": [[1.0], ["x"] * 1000, "y"]}, Nights, source="here")


def test_json_with_very_many_keys_is_refused():
    read_json(json.dumps(dict.fromkeys(range(KEYS_MAX))), "x", 1 << 20)
    with pytest.raises(
        ConfigError, match=r"^x: not valid JSON: 65537 keys in an object, expected at most 65536"
    ):
        read_json(json.dumps(dict.fromkeys(range(KEYS_MAX + 1))), "x", 1 << 20)


def test_the_first_open_fields_are_named_and_the_others_counted(tmp_path):
    """Each by a short name, however long that of its table is."""
    fields, table = [f"f{k}" for k in range(3000)], "x" * 80
    for name in (f"{table}{'x' * 10_000}", table):
        text = f"[[parts]]\nname = '{name}'\n" + "".join(f"{each} = '?'\n" for each in fields)
        with pytest.raises(ConfigError) as caught:
            read(tmp_path, text)
        *lines, more = str(caught.value).split("\n")
        source = tmp_path / "animal.toml"
        still = [f"{source}: parts.{table}.{each}: still '?', to be filled in" for each in fields[:1000]]
        assert (lines, more) == (still, f"{source}: … and 2,000 more")


def calls_to_refuse(tables):
    """Return the number of calls in Python that it takes to refuse so many tables, each with an empty list."""
    calls = []
    data = {"jaws": [{"teeth": []}] * tables}
    sys.setprofile(lambda _frame, event, _: calls.append(event == "call"))
    try:
        with pytest.raises(ConfigError):
            parse(data, Jaws, source="here")
    finally:
        sys.setprofile(None)
    return sum(calls)


def test_errors_are_put_in_words_in_linear_time():
    assert calls_to_refuse(400) < 3 * calls_to_refuse(200)


def test_a_huge_value_does_not_flood_the_message(tmp_path):
    with pytest.raises(ConfigError) as caught:
        read(tmp_path, GOOD.replace("eyes = 2", f"eyes = '{'x' * 10_000}'"))
    assert len(str(caught.value)) < 500


class Endless:
    """A value of which no text can be made, such as a tensor of 2^40 elements."""

    def __repr__(self):
        raise AssertionError


def test_a_wrong_value_is_not_written_out_to_be_shortened():
    long = ["x" * 10_000_000] * 100_000  # a terabyte of text in one of memory
    for value, shown in (
        (Endless(), "a Endless"),
        (long, "('xxxx"),
        ([[[[[1]]]]] * 10**6, "((("),
        (None, "None"),
    ):
        with pytest.raises(ConfigError, match="eyes: Input should be") as caught:
            parse({"legs": [], "eyes": value}, Animal, source="here")
        assert f", found {shown}" in str(caught.value)
        assert len(str(caught.value)) < 200


def test_missing_file_and_folder_in_its_place(tmp_path):
    for path in (tmp_path / "none.toml", tmp_path):
        with pytest.raises(RobotError, match="cannot be read"):
            read_toml(path, Animal, RobotError)


def test_requested_error_class_is_raised(tmp_path):
    assert issubclass(RobotError, FirstshiftError)
    with pytest.raises(RobotError):
        read(tmp_path, "eyes = 0", RobotError)


def test_parse_names_its_source():
    with pytest.raises(ConfigError, match=r"^here: eyes: "):
        parse({"legs": [], "eyes": 0}, Animal, source="here")
    with pytest.raises(ConfigError, match="here: \\(whole file\\)"):
        parse(7, Animal, source="here")


def test_records_are_frozen(tmp_path):
    animal = read(tmp_path, GOOD)
    with pytest.raises(ValidationError):
        animal.eyes = 3


def test_a_long_key_is_shortened(tmp_path):
    with pytest.raises(ConfigError) as caught:
        read(tmp_path, GOOD + f"{'w' * 10_000} = 2")
    assert len(str(caught.value)) < len(str(tmp_path)) + 200


def test_errors_contain_no_control_characters(tmp_path, capsys):
    def command():
        read(tmp_path, GOOD + '"\\u001b[2J" = 2\neyes2 = 3')

    assert exit_code_of(command) == BAD_INPUT
    said = capsys.readouterr().err
    assert said.count("\n") == 2
    assert "?[2J" in said
    assert said.replace("\n", "").isprintable()


def test_half_a_character_is_no_json():
    """A file or a terminal to which it is written later would fail."""
    assert read_json('{"a": "\\ud83d\\ude00"}', "a.json", 100) == {"a": "\U0001f600"}
    with pytest.raises(ConfigError, match=r"a\.json: not valid JSON: 'utf-8' codec can't encode"):
        read_json('{"a": ["\\ud800"]}', "a.json", 100)


@pytest.mark.parametrize("text", ['{"a": 1, "b": 2, "a": 1}', '[{"b": {"a": 1, "a": {}}}]'])
def test_a_key_twice_in_one_object_is_no_json(text):
    assert read_json('[{"a": {"a": 1}}, {"a": 2}]', "a.json", 100) == [{"a": {"a": 1}}, {"a": 2}]
    with pytest.raises(
        ConfigError, match=r"^a\.json: not valid JSON: key 'a' more than once, found '[\[{].+'$"
    ):
        read_json(text, "a.json", 100)
