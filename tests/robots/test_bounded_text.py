"""Text that parsers, or what walks through their results, cannot take: refused before it is parsed."""

import json
import tomllib

import pytest

from robots.bounded_text import DEPTH_MAX, DIGITS_MAX, LISTS_FREE, check_text
from robots.errors import ConfigError
from robots.strict import read_json

D, N = DEPTH_MAX, DIGITS_MAX


def check(kind, text):
    check_text(text, kind, "x", 1 << 20, ConfigError)


GOOD = {
    "JSON": (
        "[" * D + "]" * D,
        "9" * N,
        json.dumps({"a": "[" * 500 + '"{', "b": "9" * 500, "c\\": ["\\"] * 500, "d": [{}] * 500}),
        json.dumps([[0.1, 1.5e-300, -1e300]] * 500),
    ),
    "TOML": (
        "a = " + "[" * D + "]" * D,
        ".".join("a" * (D + 1)) + " = 1",
        f"a = {'9' * N}\nb = 0x{'f' * 90}",
        "a = '[[[[' # [[[[ " + "[" * 500,
        f'a = """\n{"[" * 500}\\""""\nb = \'\'\'{"{" * 500}\'\'\'\n"a.{"b." * 500}" = 1',
        "\n".join(f"[a{k}.b.c]\nd.e = [1.5, 2.5, {{f.g = 1.5}}]" for k in range(500)),
        "sha = '" + "9" * 64 + "'\n" + "w" * 500 + " = 1",
        "a = [\n  1.5,\n  # [\n  2.5 ]\n",
    ),
}
BAD = {
    "JSON": (
        ("[" * 900 + "]" * 900, "found JSON nested 900 deep, expected at most 64"),
        ('{"a":' * (D + 1) + "1" + "}" * (D + 1), "found JSON nested 65 deep"),
        (f"[1, {'9' * 5000}]", f"found the number {'9' * 20}… of 5000 digits, expected at most 100"),
        (f"[1{'0' * 400}]", f"found the number 1{'0' * 19}… of 401 digits"),
        (
            '"' + "[" * 100 + "\n" + "[" * (1 << 20),
            "found 1048678 characters of JSON, expected at most 1048576",
        ),
    ),
    "TOML": (
        ("a = " + "[" * 3000 + "]" * 3000, "found TOML nested 3000 deep, expected at most 64"),
        (".".join("a" * 3000) + " = 1", "found TOML nested 2999 deep"),
        ("[" + " . ".join('"a"' for _ in range(3000)) + "]", "found TOML nested 3000 deep"),
        ("a = " + "{b.c.d = " * 30 + "1" + "}" * 30, "found TOML nested 90 deep"),
        (f"a = {'9' * 5000}", f"found the number {'9' * 20}… of 5000 digits"),
        (f"a = -{'1_' * 100}1", "found the number 1_1_1_1_1_1_1_1_1_1_… of 201 digits"),
        (f"a = 0x{'f' * 5000}", "of 5002 digits"),
        ('a = ["""b"""", ' + "[" * 3000 + "]" * 3001, "found TOML nested 3001 deep"),
        ("a = ['''b''''', " + "[" * 3000 + "]" * 3001, "found TOML nested 3001 deep"),
    ),
}


@pytest.mark.parametrize(("kind", "text"), [(kind, text) for kind in GOOD for text in GOOD[kind]])
def test_what_a_file_may_hold_is_accepted_and_parsed(kind, text):
    check(kind, text)
    if not text.startswith("a = ["):
        {"JSON": json.loads, "TOML": tomllib.loads}[kind](text)


@pytest.mark.parametrize(("kind", "text", "message"), [(kind, *bad) for kind in BAD for bad in BAD[kind]])
def test_what_no_file_holds_is_refused(kind, text, message):
    with pytest.raises(ConfigError) as caught:
        check(kind, text)
    assert str(caught.value).startswith(f"x: {message}") or str(caught.value).endswith(
        f"{message}, expected at most 100"
    )


@pytest.mark.parametrize("unit", ['\\"', '\\"""\n', '"""\\', "'", "'''", '#"'])
def test_text_of_unfinished_strings_is_read_once(unit):
    """Read again from each of its quotes, it would take half an hour."""
    check("TOML", unit * ((1 << 20) // len(unit)))


def test_reading_json_bounds_it_first():
    with pytest.raises(ConfigError, match=r"^x: found JSON nested 65 deep"):
        read_json("[" * (D + 1), "x", 100)


def test_text_of_little_but_lists_is_refused():
    """Their memory would be many times that of the text; brackets in strings are no lists."""
    check("JSON", json.dumps([[]] * (LISTS_FREE - 1)))
    check("JSON", json.dumps("[]{}" * LISTS_FREE))
    for kind, parts in (("JSON", "objects"), ("TOML", "tables")):
        for item in ("[]", "{}"):
            with pytest.raises(
                ConfigError, match=rf"^x: found 200001 lists and {parts} of {kind}, expected at most 28750$"
            ):
                check(kind, f"[{','.join([item] * 200_000)}]")
