"""The pages in a real browser: nothing fetched, nothing broken, readable on a phone."""

import html as html_escape
import json
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import report_study
import winding_study

from pipeline.report.sweep import write_sweep
from pipeline.report.winding import write_winding
from pipeline.report.write import write_report
from pipeline.sweep import load_sweep, run_sweep

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no chromium, chromium-browser or google-chrome is installed")
SECTION_3 = Path(__file__).parents[2] / "data_samples/sweeps/yin2020_section3.toml"

# Appended to a copy of the page: the browser measures the page and writes what it found into the document.
PROBE = """
<script>
addEventListener("load", () => {
  const sizes = [...document.querySelectorAll("figure > svg")].map(s => s.getBoundingClientRect());
  const texts = [...document.querySelectorAll("figure > svg text")].map(t => t.getBoundingClientRect().height);
  const beyond = [...document.querySelectorAll("body *")].filter(e => !e.closest(".scroll") && !e.closest("svg")
    && !e.classList.contains("skip") && e.getBoundingClientRect().right > innerWidth + 1)
    .map(e => e.outerHTML.slice(0, 80));
  const found = {
    width: innerWidth,
    page: document.documentElement.scrollWidth,
    beyond: beyond,
    figures: sizes.map(r => [Math.round(r.width), Math.round(r.height)]),
    shots: [...document.querySelectorAll("svg image")].map(i => i.getBoundingClientRect().width),
    images: [...document.images].map(i => i.naturalWidth),
    smallest_text: Math.min(...texts),
    scrolls: [...document.querySelectorAll(".scroll")].filter(s => s.scrollWidth > s.clientWidth).length,
    fetched: performance.getEntriesByType("resource").map(r => r.name),
    links: [...document.querySelectorAll("nav a")].filter(a => !document.querySelector(a.getAttribute("href"))).length,
  };
  parent.postMessage(JSON.stringify(found), "*");
});
</script>
"""
# An own frame sets the width: a window of the browser cannot be made as narrow as a phone.
FRAME = """<!DOCTYPE html><html lang="en"><head><meta charset="utf-8"><title>frame</title></head>
<body style="margin:0">
<script>addEventListener("message", e => {{ document.body.dataset.found = e.data; }});</script>
<iframe src="probe.html" style="width:{width}px;height:900px;border:0"></iframe></body></html>"""


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    folder = tmp_path_factory.mktemp("browser") / "made-up"
    write_report(report_study.study(), folder)
    return folder


def browse(page: Path, profile: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    assert CHROMIUM is not None
    return subprocess.run(
        [
            CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
            "--disable-background-networking", "--disable-component-update", "--disable-sync",
            f"--user-data-dir={profile}", "--enable-logging=stderr", "--v=0", "--virtual-time-budget=5000",
            *arguments, page.as_uri(),
        ],
        capture_output=True, text=True, timeout=120, check=True,
    )  # fmt: skip


def found_in(page: Path, folder: Path, width: int) -> dict[str, Any]:
    """What the browser finds in a page shown `width` pixels wide; nothing may be written to its console."""
    html = page.read_text(encoding="utf-8")
    (folder / "probe.html").write_text(html.replace("</body>", f"{PROBE}</body>"), encoding="utf-8")
    (folder / "frame.html").write_text(FRAME.format(width=width), encoding="utf-8")
    done = browse(folder / "frame.html", folder / "profile", "--window-size=1400,1000", "--dump-dom")
    assert "CONSOLE" not in done.stderr
    match = re.search(r'data-found="([^"]*)"', done.stdout)
    assert match, done.stderr
    found = json.loads(html_escape.unescape(match[1]))
    assert found["width"] == width
    assert found["page"] <= width
    assert found["beyond"] == []
    assert all(0.8 * min(width, 600) < w <= width and h > 100 for w, h in found["figures"])
    assert all(size > 0 for size in found["images"])
    assert found["smallest_text"] >= 8
    assert found["fetched"] == []
    assert found["links"] == 0
    return found


@pytest.mark.parametrize("width", [1280, 400])
def test_the_page_stands_in_a_browser(report, tmp_path, width):
    found = found_in(report / "report.html", tmp_path, width)
    assert len(found["figures"]) == 14
    assert len(found["shots"]) == 8
    assert all(size > 40 for size in found["shots"])
    if width == 400:
        assert found["scrolls"] >= 4  # the wide tables scroll inside their own containers


@pytest.fixture(scope="module")
def sweep_page(tmp_path_factory):
    section_3 = replace(load_sweep(SECTION_3), models=("cosserat",))
    folder = tmp_path_factory.mktemp("browser") / "sweep"
    write_sweep(section_3, run_sweep(section_3), folder)
    return folder / "sweep.html"


@pytest.mark.parametrize("width", [1280, 400])
def test_the_page_of_a_sweep_stands_in_a_browser(sweep_page, tmp_path, width):
    found = found_in(sweep_page, tmp_path, width)
    assert len(found["figures"]) == 9  # Figs 6 to 12, the paths of Fig. 7, the quoted numbers
    if width == 400:
        assert found["scrolls"] >= 3


@pytest.fixture(scope="module")
def winding_page(tmp_path_factory):
    folder = tmp_path_factory.mktemp("browser")
    study = winding_study.small(folder)
    write_winding(study, winding_study.made_up(study, layers=(0.5, 0.6, 1.0, 1.1)), folder / "small")
    return folder / "small/wind.html"


@pytest.mark.parametrize("width", [1280, 400])
def test_the_page_of_a_winding_stands_in_a_browser(winding_page, tmp_path, width):
    found = found_in(winding_page, tmp_path, width)
    assert len(found["figures"]) == 6  # Figs 7 to 9, layers, frames, one parameter
    assert found["shots"]  # the packages are pixels inside the drawings
    if width == 400:
        assert found["scrolls"] >= 4


def test_the_probe_notices_a_console_message_and_a_wide_page(tmp_path):
    """The checks above can fail: a page that is broken on purpose shows up."""
    bad = f'<body><div style="width:900px">x</div><script>console.error("broken")</script>{PROBE}</body>'
    (tmp_path / "probe.html").write_text(bad, encoding="utf-8")
    (tmp_path / "frame.html").write_text(FRAME.format(width=400), encoding="utf-8")
    done = browse(tmp_path / "frame.html", tmp_path / "profile", "--window-size=1400,1000", "--dump-dom")
    assert "CONSOLE" in done.stderr
    match = re.search(r'data-found="([^"]*)"', done.stdout)
    assert match
    found = json.loads(html_escape.unescape(match[1]))
    assert found["page"] > 400
    assert found["beyond"]
