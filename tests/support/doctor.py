from policies.doctor.checklist import run_check


def text_of(case, check, verdict):
    """Text of one row of the doctor's table; its verdict is the expected one."""
    found = run_check(case, check)
    assert found.verdict is verdict
    return found.text
