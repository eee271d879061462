"""deploy-check on simulated robots: right ones pass, and each mistake is named."""

import json
import re
import signal

import numpy as np
import pytest

import deploy.commissioning.cli
import deploy.commissioning.report
import deploy.operation.session
import deploy.operation.summary
from deploy.backends.sim.robot import SimRobot
from deploy.commissioning.moves import CheckMoves
from deploy.reasons import Reason
from deploy.telemetry.plain_console import plain_console
from robots.distributions import load_distributions
from robots.draws import draw
from robots.randomness import robot_seed
from robots.spec import load_robot
from support.deploy.miswired import Wiring, exchanged, miswired
from support.paths import TEST_ROBOTS
from support.screen import NoScreen

PLANAR = load_robot("planar3")
SIM = "deploy.backends.sim.backend.SimRobot"


@pytest.fixture
def check(call, monkeypatch, tmp_path):
    """Call deploy-check: its exit code, what it said, and check.json."""
    monkeypatch.setattr(deploy.operation.session, "ConsoleProcess", NoScreen)

    def run(*arguments, wiring=None, base=SimRobot):
        monkeypatch.setattr(SIM, miswired(wiring, base) if wiring else base)
        options = ("--speed", "max", "--out", tmp_path / "out", *arguments)
        code, said, complaint = call(deploy.commissioning.cli.cli, *options)
        path = tmp_path / "out" / "check.json"
        return code, said + complaint, json.loads(path.read_text()) if path.exists() else None

    return run


def test_a_check_prints_once_its_files_are_complete_and_signals_end_it_again(check, tmp_path, monkeypatch):
    """Printing may block until somebody reads the output."""
    seen = []

    def observed(*, console=plain_console):
        seen.append((signal.getsignal(signal.SIGINT), {path.name for path in (tmp_path / "out").iterdir()}))
        return console()

    for module in (deploy.operation.summary, deploy.commissioning.report):
        monkeypatch.setattr(module, "plain_console", observed)
    before = signal.getsignal(signal.SIGINT)
    _, said, _ = check("--robot", "planar3", "--draw", "3:0")
    assert said.index("ended ") < said.index("measured, and expected below it")
    assert seen == [(before, {"run.mcap", "summary.json", "heat.json", "check.json"})] * 2


def mistakes(report):
    return {name: joint["mistakes"] for name, joint in report["joints"].items() if joint["mistakes"]}


def one_each(report):
    """The mistake of each joint that has one."""
    found = mistakes(report)
    assert all(len(texts) == 1 for texts in found.values()), found
    return {name: texts[0] for name, texts in found.items()}


@pytest.mark.slow
def test_right_robot_passes(check, tmp_path):
    code, said, report = check("--robot", "planar3", "--seed", 3)
    assert (code, report["passed"], mistakes(report), report["stopped"]) == (0, True, {}, "")
    draw = SimRobot(PLANAR, [np.random.SeedSequence(3, spawn_key=(2**31, 0))]).draw
    for joint, (name, found) in enumerate(report["joints"].items()):
        assert (found["order"], found["sign"], found["passed"]) == (name, 1, True)
        assert found["scale"]["value"] == pytest.approx(1.0, abs=0.005)
        late = found["delay"]["value"] - draw["drives.delay_s"][0]
        assert abs(late) < 0.002
        assert 0 < found["tracking"]["value"] < 0.01
        expected = draw["joints.friction"][0, joint] * (0.5, 0.25, 0.1)[joint]
        assert found["friction"]["value"] > 0.9 * expected
    assert report["unverified"] == []  # of a stretched arm gravity tells all
    assert "passed" in said
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        *("run.mcap", "summary.json", "heat.json", "check.json")
    }


@pytest.mark.slow
@pytest.mark.parametrize(
    ("robot", "draw"),
    [("arm6", 1), ("planar3", 0), ("planar4", 1)],
)
def test_drawn_robots_cause_no_false_alarm(check, robot, draw):
    code, said, report = check("--robot", robot, "--draw", f"11:{draw}")
    assert (code, mistakes(report)) == (0, {}), said
    vertical_axis = "drive and encoder of shoulder_pan both reversed"  # no torque of gravity
    assert (vertical_axis in report["unverified"]) == (robot == "arm6")


UNARMED = {  # an encoder that is exchanged or reversed away from 0 shows another pose
    "encoders exchanged": (
        Wiring(encoders=exchanged(0, 1)),
        {
            "shoulder_pan": "outside [-1.300, 1.300]: exchanged with shoulder_lift or wrist_3",
            "shoulder_lift": "outside [-2.400, -0.300]: exchanged with shoulder_pan or wrist_1",
        },
    ),
    "drives exchanged": (
        Wiring(encoders=exchanged(1, 2), commands=exchanged(1, 2), currents=exchanged(1, 2)),
        {
            "shoulder_lift": "exchanged with elbow, or its sign reversed",
            "elbow": "exchanged with shoulder_lift, or its sign reversed",
        },
    ),
    "encoder reversed": (
        Wiring(encoder_scale={2: -1}),
        {"elbow": "encoder reads -1.571 rad, outside [0.300, 2.650]: its sign reversed"},
    ),
    "encoder scaled": (
        Wiring(encoder_scale={1: 0.5}),
        {"shoulder_lift": "rad, -1.571 at home: zero, scale or pose?"},
    ),
}


@pytest.mark.parametrize("case", UNARMED)
def test_wrong_encoder_is_named_without_power(check, case):
    wiring, expected = UNARMED[case]
    code, said, report = check("--robot", "arm6", wiring=wiring)
    found = one_each(report)
    assert (code, found.keys()) == (1, expected.keys()), said
    for name, text in expected.items():
        assert text in found[name]
    assert report["stopped"]


JUMPS = {  # a command that is not the joint's own moves it as soon as power comes on
    "commands exchanged": (
        Wiring(commands=exchanged(0, 1)),
        {
            "shoulder_pan": "commands exchanged with shoulder_lift",
            "shoulder_lift": "commands exchanged with shoulder_pan",
        },
    ),
    "command reversed": (
        Wiring(command_scale={2: -1}),
        {"elbow": "sign of commands reversed, or scale of commands or encoder below 1"},
    ),
    "command halved": (
        Wiring(command_scale={3: 0.5}),
        {"wrist_1": "sign of commands reversed, or scale of commands or encoder below 1"},
    ),
    "command enlarged": (
        Wiring(command_scale={3: 1.5}),
        {"wrist_1": "scale of commands or encoder above 1"},
    ),
}


@pytest.mark.parametrize("case", JUMPS)
def test_jump_at_power_on_is_stopped_and_named(check, case):
    wiring, expected = JUMPS[case]
    code, said, report = check("--robot", "arm6", wiring=wiring)
    found = one_each(report)
    assert (code, found.keys()) == (1, expected.keys()), said
    for name, text in expected.items():
        assert found[name].endswith(f"when power came on: {text}")
        assert abs(float(found[name].split()[1])) < 0.5  # rad: stopped at once
    assert report["stopped"]


def test_drives_that_hold_another_joints_load_are_named_without_motion(check):
    """Both joints stand at the same angle: only the motors' torques tell."""
    both = exchanged(1, 3)
    code, _, report = check("--robot", "arm6", wiring=Wiring(encoders=both, commands=both, currents=both))
    text = "would fit: drives of shoulder_lift and wrist_1 exchanged, with their encoders"
    found = mistakes(report)
    assert (code, found.keys()) == (1, {"shoulder_lift", "wrist_1"})
    assert all(texts[-1] == text for texts in found.values())
    assert found["wrist_1"][0].startswith("motor holds -")
    assert report["stopped"] == "a motor's current does not fit its motion (wrist_1)"


NUDGED = {  # planar3 stands at 0, where nothing jumps
    "commands exchanged": (
        Wiring(commands=exchanged(0, 1, 3)),
        {
            "shoulder": "encoder of elbow moves instead: commands exchanged",
            "elbow": "encoder of shoulder moves instead: commands exchanged",
        },
    ),
    "encoders exchanged": (
        Wiring(encoders=exchanged(1, 2, 3)),
        {
            "elbow": "encoder of wrist moves instead: encoders exchanged",
            "wrist": "encoder of elbow moves instead: encoders exchanged",
        },
    ),
    "command reversed": (
        Wiring(command_scale={1: -1}),
        {"elbow": "moves the wrong way: sign of commands reversed"},
    ),
    "encoder reversed": (
        Wiring(encoder_scale={2: -1}),
        {"wrist": "moves the wrong way: sign of encoder reversed"},
    ),
    "command doubled": (
        Wiring(command_scale={0: 2.0}),
        {"shoulder": r"moves (1\.9|2\.0)"},
    ),
    "encoder a tenth too large": (
        Wiring(encoder_scale={1: 1.1}),
        {"elbow": r"moves 1\."},
    ),
    "encoder silent": (
        Wiring(encoder_scale={2: 0.0}),
        {"wrist": "does not move: drive, brake or encoder"},
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", NUDGED)
def test_mistake_is_named_by_the_first_motion(check, case):
    wiring, expected = NUDGED[case]
    # Whether commands or encoders are exchanged is told from noisy currents: with other seeds it may be left open.
    code, said, report = check("--robot", "planar3", "--seed", 1, wiring=wiring)
    found = mistakes(report)
    assert (code, found.keys()) == (1, expected.keys()), said
    for name, text in expected.items():
        assert re.match(text, found[name][0]), found


@pytest.mark.slow
def test_whole_drives_exchanged_are_named_by_gravity(check):
    both = exchanged(0, 1, 3)
    _, _, report = check("--robot", "planar3", wiring=Wiring(encoders=both, commands=both, currents=both))
    found = mistakes(report)
    text = "would fit: drives of shoulder and elbow exchanged, with their encoders"
    assert text in found["shoulder"]
    assert text in found["elbow"]
    assert any("torque against gravity" in each for each in found["shoulder"] + found["elbow"])


@pytest.mark.slow
def test_whole_drive_reversed_is_named_by_gravity(check):
    wiring = Wiring(command_scale={1: -1}, encoder_scale={1: -1}, current_scale={1: -1})
    _, _, report = check("--robot", "planar3", wiring=wiring)
    assert "would fit: drive and encoder of elbow both reversed" in mistakes(report)["elbow"]


def test_load_that_is_too_heavy_is_named_without_motion(check):
    class Heavy(SimRobot):
        def __init__(self, spec, seeds, *, draw=None, **how):
            drawn = SimRobot(spec, seeds).draw
            mass = drawn["links.mass"].copy()
            mass[:, 2] = 6.0
            super().__init__(spec, seeds, draw=drawn.replaced({"links.mass": mass}), **how)

    code, _, report = check("--robot", "planar3", base=Heavy)
    assert code == 1
    assert "a motor's current does not fit its motion" in report["stopped"]
    named = set(mistakes(report))  # both carry that segment; the wrist falls by about the 10 mrad that count
    assert "elbow" in named
    assert named <= {"elbow", "wrist"}
    for (mistake,) in mistakes(report).values():
        assert mistake.endswith("when power came on: its motor does not hold it")


@pytest.mark.slow
def test_late_commands_are_found(check):
    _, _, report = check("--robot", "planar3", wiring=Wiring(late=4))
    assert all("follows its setpoint" in text for text in one_each(report).values())
    assert len(mistakes(report)) == 3


@pytest.mark.slow
def test_another_mass_and_a_dragging_joint_are_found(check):
    class Heavy(SimRobot):
        def __init__(self, spec, seeds, *, draw=None, **how):
            drawn = SimRobot(spec, seeds).draw
            friction = drawn["joints.friction"].copy()
            friction[:, 1] = 8.0
            mass = drawn["links.mass"].copy()
            mass[:, 2] = 2.5
            super().__init__(
                spec, seeds, draw=drawn.replaced({"joints.friction": friction, "links.mass": mass}), **how
            )

    code, _, report = check("--robot", "planar3", base=Heavy)
    found = mistakes(report)
    assert code == 1
    assert any(text.startswith("friction 2.") for text in found["elbow"])
    assert any(text.startswith("torque against gravity") for text in found["wrist"])


def test_a_draw_in_the_place_of_the_findings_is_exit_2_and_left_unchanged(check, tmp_path):
    place, distributions = tmp_path / "out" / "check.json", load_distributions(PLANAR)
    drawn = json.loads(draw(distributions, PLANAR, [robot_seed(7, 0)]).to_json(7, distributions, PLANAR))
    place.parent.mkdir()
    place.write_text(json.dumps(drawn))
    code, said, left = check("--robot", "planar3", "--draw", f"{place}:0")
    assert (code, left) == (2, drawn)
    assert f"error: --out {place}: found a file that is read, expected another place\n" in said


def test_interrupted_check_is_exit_130(check, monkeypatch):
    waits = iter(range(100_000))

    def wait(_):
        if next(waits) == 400:
            signal.raise_signal(signal.SIGINT)
        return 0.0

    monkeypatch.setattr("deploy.operation.loop_timing.Unpaced.wait", wait)
    code, _, report = check("--robot", "planar3")
    assert (code, report["passed"], report["stopped"]) == (130, False, "stopped by the operator")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("stop", "code", "reason"),
    [
        (lambda _: signal.raise_signal(signal.SIGQUIT), 130, "stopped by the operator"),
        (
            lambda run: run.runtime.stop(Reason.OVERRUN),
            1,
            "too many ticks were late; stopped by the operator",
        ),
    ],
    ids=["interrupt", "overrun"],
)
def test_a_stop_after_the_last_motion_is_no_pass(check, monkeypatch, stop, code, reason):
    class Late(CheckMoves):
        def __call__(self, run):
            before = self._done
            super().__call__(run)
            if self._done and not before:
                stop(run)

    monkeypatch.setattr(deploy.commissioning.cli, "CheckMoves", Late)
    found, said, report = check("--robot", "planar3", "--seed", 3)
    assert (found, report["passed"], report["stopped"], mistakes(report)) == (code, False, reason, {})
    assert f"stopped: {reason}" in said
    assert "failed" in said


def test_robot_that_is_too_hot_is_not_moved(check):
    class Hot(SimRobot):
        def __init__(self, *args, **how):
            super().__init__(*args, **how)
            self.plant.housing[:] = 95.0
            self.settle_sensors(np.ones(1, dtype=bool))

    code, said, report = check("--robot", "planar3", base=Hot)
    assert (code, report["passed"], mistakes(report)) == (1, False, {})
    assert report["stopped"] == "a motor is too hot, or its temperature is unknown"
    assert "failed" in said


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--robot", "arm7"), "error: --robot arm7: no such folder with a robot.toml; known: arm6"),
        (("--backend", "canopen"), "error: --backend canopen: unknown; known: sim"),
        (("--angle-deg", "1.9"), "error: --angle-deg 1.9: expected degrees from 2 to 15"),
        (("--angle-deg", "16"), "error: --angle-deg 16: expected degrees from 2 to 15"),
        (("--angle-deg", "nan"), "error: --angle-deg nan: expected degrees from 2 to 15"),
        (("--angle-deg", "wide"), "Invalid value for '--angle-deg'"),
        (("--speed", "fast"), "error: --speed fast: expected a factor from 0.1"),
        (("--draw", "7"), "error: --draw 7: expected SEED:ROBOT"),
        (("--policy", "x.onnx"), "No such option: --policy"),
        (
            ("--robot", str(TEST_ROBOTS / "quadruped")),
            "error: --robot quadruped: found a floating base, expected a fixed one: hang the robot from its gantry",
        ),
    ],
)
def test_bad_option_is_exit_2_and_writes_nothing(check, tmp_path, arguments, message):
    code, said, _ = check(*arguments)
    assert code == 2
    assert message in said
    assert not (tmp_path / "out").exists()
