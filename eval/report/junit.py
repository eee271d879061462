"""junit.xml: one test case for each budget line."""

from junitparser import Failure, JUnitXml, Skipped, TestCase, TestSuite

from eval.report.schema.report_data import BudgetLine, Report


def junit(report: Report) -> str:
    """Return the XML text; lines of an interrupted soak that have passed so far are marked as skipped."""
    suite = TestSuite("soak-test")
    suite.timestamp = report.run.started
    suite.add_property("statement", report.statement)
    suite.add_property("policy_digest", report.settings.policy_digest)
    for line in report.budget:
        case = TestCase(line.name, classname=f"soak.{report.settings.robot}", time=0)
        if not line.passed:
            case.result = [Failure(describe(line), "budget")]
        elif report.run.interrupted:
            case.result = [Skipped(f"interrupted after {report.run.hours:.3g} h; so far {describe(line)}")]
        suite.add_testcase(case)
    suite.time = report.run.wall_s
    document = JUnitXml()
    document.add_testsuite(suite)
    return document.tostring().decode()


def describe(line: BudgetLine) -> str:
    """Return the line in words."""
    found = "not finite" if line.found is None else f"{line.found:.6g}"
    bound = "at least" if line.at_least else "at most"
    allowed = "no limit" if line.allowed is None else f"allowed {bound} {line.allowed:.6g}"
    about = f" ({line.about})" if line.about else ""
    return f"{line.name}: found {found} {line.unit}, {allowed}{about}"
