"""The report in a real browser, as wide as a laptop and as a phone, where there is one."""

import html
import json
import re
import shutil
import subprocess
from dataclasses import replace

import pytest

from eval.report.build import build
from eval.statistics.budget import load_budget
from support.eval.reports import BUNDLE, rendered, soak

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
BROWSER = next((name for name in BROWSERS if shutil.which(name)), None)
OPTIONS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-dev-shm-usage",
    "--enable-logging=stderr",
)
WIDTHS = (390, 1200)
FIGURES = 6 + 4 + 1 + 2
MEASURE = """<script>
const size = svg => svg.getBoundingClientRect(), root = document.documentElement;
const target = document.querySelector(".matrix a");
addEventListener("load", () => {
  const closed = [...document.querySelectorAll("details:not([open])")].length;
  target.click();
  parent.postMessage({
    width: innerWidth, needed: root.scrollWidth, closed,
    heights: [...document.querySelectorAll("svg")].map(svg => Math.round(size(svg).height)),
    below: Math.round(size(document.querySelector(".tiles")).bottom + scrollY),
    shown: size(document.querySelector(target.hash)).height > 0,
  }, "*");
});
</script>"""
FRAMES = """<!doctype html><body>%s<script>
const found = {};
addEventListener("message", e => { found[e.data.width] = e.data; document.title = JSON.stringify(found); });
</script>"""
FRAME = '<iframe src="page.html" style="width:{}px;height:900px;border:0"></iframe>'


def browse(folder, text):
    """What the page measures of itself at each width, and what the console has to say."""
    (folder / "page.html").write_text(text.replace("</body>", MEASURE + "</body>"), encoding="utf-8")
    (folder / "frames.html").write_text(FRAMES % "".join(map(FRAME.format, WIDTHS)), encoding="utf-8")
    profile = f"--user-data-dir={folder / 'profile'}"
    ended = subprocess.run(
        [
            BROWSER,
            *OPTIONS,
            profile,
            "--virtual-time-budget=20000",
            "--dump-dom",
            (folder / "frames.html").as_uri(),
        ],
        capture_output=True,
        text=True,
        check=True,
        timeout=300,
    )
    found = html.unescape(re.search("<title>(.*?)</title>", ended.stdout)[1])
    return json.loads(found), [line for line in ended.stderr.splitlines() if "CONSOLE" in line]


@pytest.mark.skipif(BROWSER is None, reason="no browser")
@pytest.mark.slow
def test_browser_renders_the_report_without_errors(tmp_path):
    result = replace(soak(["velocity", "position_requested"]), bundles=(BUNDLE,))
    found, complaints = browse(tmp_path, rendered(build(result, load_budget())))
    assert complaints == []
    assert sorted(map(int, found)) == sorted(WIDTHS)
    for width in WIDTHS:
        page = found[str(width)]
        assert page["needed"] <= width, "it must be scrolled sideways"
        assert len(page["heights"]) == FIGURES
        assert min(page["heights"]) > 60
        # Soft events are folded away, and a number in the matrix unfolds them.
        assert (page["closed"], page["shown"]) == (1, True)
        assert page["below"] < 900, "not on the first screen"


@pytest.mark.skipif(BROWSER is None, reason="no browser")
@pytest.mark.slow
def test_browser_check_detects_a_broken_page(tmp_path):
    text = rendered(build(soak(["velocity"]), load_budget()))
    broken = text.replace('d="M', 'd="Q', 1)
    assert broken != text
    _, complaints = browse(tmp_path, broken)
    assert complaints
