from eval.fuzz.worker import ACCEPTED, REFUSED, make_case, read_case

SEED = 7


def check_cases(targets, name, folder, count):
    """Read a target's example, and mutations of it: each is read or refused."""
    target, example = targets[name], folder / "example"
    example.mkdir()
    target.make(example)
    assert read_case(target, example) == ACCEPTED
    outcomes = []
    for number in range(count):
        make_case(target, name, example, folder / "case", seed=SEED, number=number)
        outcomes.append(read_case(target, folder / "case"))
    assert set(outcomes) <= {ACCEPTED, REFUSED}, outcomes
