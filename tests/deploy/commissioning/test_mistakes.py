"""Names of mistakes for responses made up by hand."""

import numpy as np
import pytest

from deploy.commissioning.mistakes import jump, nudged
from deploy.commissioning.responses import Response

NAMES = ("a", "b", "c")
QUIET = np.full(3, 0.01)


def answer(encoder, current=(0.5, 0.0, 0.0)):
    return Response(encoder=np.array(encoder), noise=QUIET, current=np.array(current), current_noise=QUIET)


@pytest.mark.parametrize(
    ("encoder", "current", "expected"),
    [
        ((1.0, 0.0, 0.0), (0.5, 0.0, 0.0), None),
        ((1.2, 0.1, -0.1), (0.5, 0.0, 0.0), None),
        ((0.0, 0.1, 0.0), (0.0, 0.0, 0.0), "does not move: drive, brake or encoder"),
        ((0.0, 0.0, 1.0), (0.5, 0.0, 0.0), "encoder of c moves instead: encoders exchanged"),
        ((0.0, 0.0, 1.0), (0.0, 0.0, 0.5), "encoder of c moves instead: commands exchanged"),
        ((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), "encoder of c moves instead: commands or encoders exchanged"),
        (
            (0.0, -1.0, 0.0),
            (0.5, 0.0, 0.0),
            "encoder of b moves instead: encoders exchanged, one of them with its sign reversed",
        ),
        ((-1.0, 0.0, 0.0), (0.5, 0.0, 0.0), "moves the wrong way: sign of encoder reversed"),
        ((-1.0, 0.0, 0.0), (-0.5, 0.0, 0.0), "moves the wrong way: sign of commands reversed"),
        ((-1.0, 0.0, 0.0), (0.0, 0.0, 0.0), "moves the wrong way: sign of commands or encoder reversed"),
        (
            (-3.0, 0.0, 0.0),
            (0.5, 0.0, 0.0),
            "moves the wrong way: sign of encoder reversed, and moves 3.00 times as far",
        ),
        ((2.5, 0.0, 0.0), (0.5, 0.0, 0.0), "moves 2.50 times as far: scale of commands or encoder"),
        (
            (1.0, 0.6, 0.0),
            (0.5, 0.3, 0.0),
            "moves b too: coupled joints, or commands that reach several drives",
        ),
    ],
)
def test_response_of_the_first_joint(encoder, current, expected):
    assert nudged(NAMES, 0, answer(encoder, current)) == expected


def test_noise_is_no_motion():
    """A response within four standard deviations of noise is none."""
    noisy = answer((0.5, 0.0, 0.0))._replace(noise=np.full(3, 0.2))
    assert nudged(NAMES, 0, noisy) == "does not move: drive, brake or encoder"


@pytest.mark.parametrize(
    ("q", "moved", "current", "expected"),
    [
        (
            (1.0, -1.0, 0.0),
            (-0.1, 0.1, 0.0),
            (-5.0, 5.0, 0.0),
            {0: "commands exchanged with b", 1: "commands exchanged with a"},
        ),
        (
            (1.0, -1.0, 0.0),
            (-0.1, 0.1, 0.0),
            (5.0, -5.0, 0.0),
            {0: "encoders exchanged with b", 1: "encoders exchanged with a"},
        ),
        ((0.0, 0.0, 1.0), (0.0, 0.0, -0.1), (0.0, 0.0, 5.0), {2: "sign of encoder reversed"}),
        ((0.0, 0.0, 1.0), (0.0, 0.0, 0.1), (0.0, 0.0, 5.0), {2: "scale of commands or encoder above 1"}),
        ((0.0, 0.0, 1.0), (0.0, 0.0, 0.1), (0.0, 0.0, -5.0), {2: "its motor does not hold it"}),
        ((0.0, 0.0, 0.01), (0.0, 0.0, 0.1), (0.0, 0.0, 5.0), {2: "its motor does not hold it"}),
        ((1.0, 1.0, 1.0), (0.0, 0.0, 0.0), (5.0, 5.0, 5.0), {}),
    ],
)
def test_jump_at_power_on(q, moved, current, expected):
    found = dict(jump(NAMES, *map(np.array, (q, moved, current))))
    assert found.keys() == expected.keys()
    for joint, text in expected.items():
        assert found[joint].endswith(f"when power came on: {text}")
