import os
import sys
import termios

import pytest

from deploy.operation.keyboard import END, Keyboard
from robots.errors import ConfigError


@pytest.fixture
def pipe():
    reading, writing = os.pipe()
    with os.fdopen(reading) as stream:
        yield stream, writing


@pytest.fixture
def terminal():
    ours, theirs = os.openpty()
    with os.fdopen(theirs) as stream:
        yield stream, ours
    os.close(ours)


def test_pipe_gives_one_key_at_a_time_and_then_its_end(pipe):
    stream, writing = pipe
    keyboard = Keyboard(stream)
    assert keyboard.read() == []
    os.write(writing, b"1+\x1b[Dq")
    assert [keyboard.read() for _ in range(5)] == [["1"], ["+"], ["left"], ["q"], []]
    os.close(writing)
    assert [keyboard.read() for _ in range(2)] == [[END], [END]]


def test_pipe_is_read_no_faster_than_its_keys_are_used(pipe):
    stream, writing = pipe
    keyboard = Keyboard(stream)
    os.write(writing, b"+" * 5000)
    for _ in range(10):
        assert keyboard.read() == ["+"]
    os.close(writing)
    assert len(os.read(stream.fileno(), 10_000)) >= 2000  # still in the pipe
    assert keyboard.read() == ["+"]


def test_terminal_gives_all_keys_that_came(terminal):
    stream, ours = terminal
    with Keyboard(stream) as keyboard:
        os.write(ours, "2\x1b[A\x1bOB\x1b[Cé ".encode())
        assert keyboard.read() == ["2", "up", "down", "right", "\ufffd", "\ufffd", " "]
        assert keyboard.read() == []


OTHER_KEYS = {
    "Ctrl+Right": b"\x1b[1;5C",
    "Shift+Right": b"\x1b[1;2C",
    "F5": b"\x1b[15~",
    "F1": b"\x1bOP",
    "Alt+Left of a keypad": b"\x1bO3D",
}


@pytest.mark.parametrize("sent", OTHER_KEYS.values(), ids=OTHER_KEYS)
def test_other_keys_are_unknown_as_a_whole(terminal, pipe, sent):
    """Their digits would choose a joint."""
    (stream, ours), (piped, writing) = terminal, pipe
    with Keyboard(stream) as keyboard:
        os.write(ours, sent + b"2")
        assert keyboard.read() == ["unknown", "2"]
        for byte in sent:
            assert keyboard.read() == []
            os.write(ours, bytes([byte]))
        assert keyboard.read() == ["unknown"]
    keyboard = Keyboard(piped)
    os.write(writing, sent + b"2" + sent[:-1])
    assert [keyboard.read() for _ in range(3)] == [["unknown"], ["2"], []]
    os.close(writing)
    assert [keyboard.read() for _ in range(2)] == [["unknown"], [END]]


@pytest.mark.parametrize("begun", [b"\x1b", b"\x1b[", b"\x1b[1;", b"\x1b[" + 16 * b"1"])
def test_a_sequence_that_is_begun_does_not_take_the_key_that_stops(terminal, begun):
    stream, ours = terminal
    with Keyboard(stream) as keyboard:
        os.write(ours, begun)
        keyboard.read()
        os.write(ours, b" ")
        assert keyboard.read()[-1] == " "


def test_terminal_is_restored_after_an_error(terminal):
    stream, _ = terminal
    before = termios.tcgetattr(stream)
    assert before[3] & termios.ICANON
    flags = []

    def fail():
        with Keyboard(stream):
            flags.append(termios.tcgetattr(stream)[3])
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert not flags[0] & (termios.ICANON | termios.ECHO)
    assert flags[0] & termios.ISIG  # Ctrl-C is still a signal
    assert termios.tcgetattr(stream) == before


def test_terminal_that_closes_ends_the_keys():
    ours, theirs = os.openpty()
    with os.fdopen(theirs) as stream, Keyboard(stream) as keyboard:
        os.close(ours)
        assert keyboard.read() == [END]


def test_terminal_that_closes_before_it_is_entered_is_an_error():
    ours, theirs = os.openpty()
    with os.fdopen(theirs) as stream:
        keyboard = Keyboard(stream)
        os.close(ours)
        with pytest.raises(ConfigError, match="--policy jog: found a terminal that was closed"):
            keyboard.__enter__()


@pytest.mark.parametrize("stream", [None, "closed"])
def test_closed_input_is_refused(monkeypatch, pipe, stream):
    closed = pipe[0]
    if stream:
        closed.close()
    monkeypatch.setattr(sys, "stdin", closed if stream else None)
    with pytest.raises(ConfigError, match="--policy jog: standard input is closed, expected a terminal"):
        Keyboard()
    os.close(pipe[1])
