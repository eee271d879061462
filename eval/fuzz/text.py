"""Mutation of JSON, TOML and YAML: their words, values and nesting."""

import re

import numpy as np

TOKEN = re.compile(
    r'"(?:[^"\\\n]|\\.)*"|[-+]?\d[\d_]*(?:\.\d+)?(?:[eE][-+]?\d+)?|\w+|[\[\]{}:,=.]|\n', re.ASCII
)
VALUES = (
    *("0", "-1", "1", "-0.0", "0.5", "1e308", "1e400", "-1e400", "9007199254740993", "9223372036854775808"),
    *(
        "9" * 100,
        "9" * 5000,
        "1" + "0" * 400,
        "0x" + "f" * 5000,
        "0." + "1" * 5000,
        "nan",
        "NaN",
        "inf",
        "-Infinity",
    ),
    *(
        "true",
        "null",
        "~",
        "[]",
        "{}",
        "[[]]",
        '""',
        "''",
        '"' + "x" * 100_000 + '"',
        "2026-01-01",
        "25:61:61",
    ),
    *("[" * 70 + "]" * 70, "[" * 900 + "]" * 900, "[" * 3000, '{"a":' * 900 + "1" + "}" * 900, "{a = " * 900),
    *(
        '"\\u0000"',
        '"\\ud800"',
        '"\\u001b[2J"',
        '"../../etc/passwd"',
        '"/dev/zero"',
        '"?"',
        "*a",
        "&a [*a, *a]",
    ),
    *(
        ".".join("a" * 3000),
        "[" + ".".join("b" * 3000) + "]",
        "\n[a]\n" * 300,
        "#",
        '"""',
        "'''",
        "\\",
        "\x00",
    ),
)
"""Values that some field, parser or message does not expect."""


def mutate_text(data: bytes, rng: np.random.Generator) -> bytes:
    """Return text with one to three of its words, values or signs replaced, removed, repeated or exchanged."""
    text = data.decode()
    for _ in range(rng.integers(1, 4)):
        tokens = [match.span() for match in TOKEN.finditer(text)]
        if not tokens:
            break
        (start, end), (begin, stop) = (tokens[rng.integers(len(tokens))] for _ in range(2))
        kind = rng.integers(5)
        if kind <= 1:
            text = text[:start] + VALUES[rng.integers(len(VALUES))] + text[end:]
        elif kind == 2:
            text = text[:start] + text[end:]
        elif kind == 3:
            text = text[:start] + text[begin:stop] + text[end:]
        else:
            text = text[:start] + text[min(start, begin) : max(end, stop)] + text[start:]
    return text.encode(errors="surrogateescape")
