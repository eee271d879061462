"""Trial of a policy of unknown origin in a separate process, with bounds of time and memory: it may crash.

python -P -m deploy.policy.step_trial SOURCE LIFELINE 0|1 ROBOTS... < policy.onnx
"""

import json
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence

import numpy as np

from deploy.policy.inference import BATCHES, OnnxSession, load_session
from deploy.policy.onnx_graph import shortened
from deploy.policy.policy_names import GOLDEN_KEY, INPUT, MEMORY, NEXT
from robots.arrays import Float32s
from robots.child_process import GRACE_S, Lifeline, check_not_crowded, end_with
from robots.errors import ContractError
from robots.resource_limits import limit_process

STEP_SHARE = 0.5
"""Largest part of the policy's period that its step may take: estimation, smoother and checks need the rest."""
STEPS = 50
"""Steps of a trial; their median counts, since other processes may interrupt some."""
CPU_S, MEMORY_GIB = 20, 4
"""Bounds of a trial: starting ONNX Runtime takes about one second, a network of 256 MiB a few more."""
WALL_S = 3 * CPU_S
"""The machine may have other work."""
REFUSED = 2
"""Exit code for bad input."""


def check_step(data: bytes, period_s: float, source: str) -> None:
    """Check that one step of a policy file, for one robot, takes at most `STEP_SHARE` of its period.

    Raises:
        ContractError: as `try_step`, with its golden pairs, or it takes longer.
    """
    if (found := try_step(data, source, golden=True)) > (bound := STEP_SHARE * period_s):
        expected = f"expected at most {1e3 * bound:.3g} ms, {STEP_SHARE:g} of the policy's period"
        raise ContractError(f"{source}: a step takes {1e3 * found:.3g} ms on this machine, {expected}")


def try_step(data: bytes, source: str, batches: Sequence[int] = BATCHES, *, golden: bool = False) -> float:
    """Load a model and run it for one robot, in a separate process; return the median time of a step, s.

    Args:
        data: the file. source: its name.
        batches: as of `load_session`.
        golden: run the golden pairs of a policy file, too, for as many robots as each of `batches`.

    Raises:
        ContractError: it takes too long or needs too much memory, crashes, or ONNX Runtime refuses it.
        OSError: the computer lacks a process, open files or memory for it.
    """
    bounds = f"{source}: cannot be tried within {CPU_S} s of a core and {MEMORY_GIB} GiB"
    with Lifeline() as lifeline:
        end, limit_s = lifeline.end.fileno(), WALL_S + GRACE_S
        arguments = source, str(end), str(int(golden)), *map(str, batches)
        child = [sys.executable, "-P", "-m", "deploy.policy.step_trial", *arguments]
        try:
            done = subprocess.run(
                child, input=data, capture_output=True, check=False, pass_fds=(end,), timeout=limit_s
            )
        except subprocess.TimeoutExpired as e:
            raise ContractError(f"{bounds}: not finished after {limit_s:g} s") from e
    check_not_crowded(done.returncode)
    said, complaint = done.stdout.decode(), done.stderr.decode(errors="replace").strip()
    if done.returncode == REFUSED:
        raise ContractError(complaint)
    if done.returncode or not said:
        last = complaint.rpartition("\n")[2]
        raise ContractError(f"{bounds}: exit code {done.returncode}{last and f': {last:.200}'}")
    return float(said)


def median_step_s(session: OnnxSession, source: str) -> float:
    """Return s, the median time of a step for one robot, of steps that take at most a second together.

    Raises:
        ContractError: ONNX Runtime cannot run the model.
    """
    rng, times = np.random.default_rng(0), list[float]()
    shapes = {  # dimensions with a name are the batch
        each.name: [size if isinstance(size, int) else 1 for size in each.shape]
        for each in session.get_inputs()
    }
    inputs = {name: rng.normal(size=shape).astype(np.float32) for name, shape in shapes.items()}
    while len(times) < STEPS and sum(times) < 1.0:
        begin = time.perf_counter()
        _run(session, inputs, source)
        times.append(time.perf_counter() - begin)
    return float(np.median(times))


def run_golden_pairs(session: OnnxSession, batches: Sequence[int], source: str) -> None:
    """Run the golden pairs of a policy file in the order of `Policy.verify`, which needs as much time and memory.

    That class is not imported, which takes seconds: this process is started with each run.

    Raises:
        ContractError: ONNX Runtime cannot run the model.
    """
    pairs = json.loads(session.get_modelmeta().custom_metadata_map[GOLDEN_KEY])
    rows = np.array(pairs["observation"], np.float32)
    inputs = {each.name: each.shape for each in session.get_inputs()}
    for batch in batches:
        if MEMORY in inputs:
            memory = np.zeros((batch, inputs[MEMORY][1]), np.float32)
            for row in rows:
                each = {INPUT: np.repeat(row[None], batch, axis=0), MEMORY: memory}
                memory = _run(session, each, source)[NEXT]
            continue
        for first in range(0, len(rows), batch):
            _run(session, {INPUT: rows[np.arange(first, first + batch) % len(rows)]}, source)


def _run(session: OnnxSession, inputs: Mapping[str, Float32s], source: str) -> dict[str, Float32s]:
    """Return the outputs of a step by name."""
    try:
        found = session.run(None, inputs)
    except Exception as e:  # ONNX Runtime's errors share no base
        batch = len(next(iter(inputs.values())))
        raise ContractError(f"{source}: cannot be run at batch {batch}: {shortened(e)}") from e
    return dict(zip((each.name for each in session.get_outputs()), found, strict=True))


def _main(source: str, lifeline: str, golden: str, *batches: str) -> int:
    end_with(int(lifeline))
    signal.alarm(WALL_S)
    limit_process(CPU_S, MEMORY_GIB)
    sizes = [*map(int, batches)]
    try:
        session = load_session(sys.stdin.buffer.read(), source, sizes)
        print(median_step_s(session, source))
        if int(golden):
            run_golden_pairs(session, sizes, source)
    except ContractError as e:
        print(e, file=sys.stderr)
        return REFUSED
    return 0


if __name__ == "__main__":
    sys.exit(_main(*sys.argv[1:]))
