"""Drawing of plots."""

import subprocess
import sys

DRAW = """
import sys
from eval.report.plots.canvas import canvas, svg

before = {*sys.modules}
figure, axes = canvas(4, 3)
axes.plot([0, 1], [0, 1])
svg(figure, "name", "label")
print(*sorted(name for name in {*sys.modules} - before if name.startswith("matplotlib")))
"""


def test_nothing_of_matplotlib_is_imported_late():
    """Ctrl-C in a C extension that is being imported becomes an ImportError; at the start nobody sees it."""
    assert subprocess.check_output([sys.executable, "-c", DRAW], text=True) == "\n"
