"""The report folder: complete, consistent, free of this machine, and whole or not at all."""

import csv
import json
import os
import re
import signal
import subprocess
import sys
import time
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import nbformat
import pytest
import report_study

from pipeline import atomic, store
from pipeline.errors import InputError
from pipeline.report import notebook, tables, write

ROOT = Path(__file__).parents[2]
SCRIPT = """
import sys
from pathlib import Path
import report_study
from pipeline.report.write import write_report
write_report(report_study.study(), Path(sys.argv[1]))
"""


def contents(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def earlier(folder: Path) -> dict[str, bytes]:
    """Put an earlier report in place and return what it holds."""
    (folder / "figures").mkdir(parents=True)
    (folder / "report.html").write_text("the earlier report")
    (folder / "figures" / "old.svg").write_text("the earlier figure")
    return contents(folder)


def test_the_folder_holds_the_contract(report):
    assert {p.name for p in report.iterdir()} == write.CONTENTS
    assert {p.stem for p in (report / "figures").glob("*.svg")} == {
        "fig13a_tension", "fig13b_twist", "fig13c_theta", "frame_term", "error_against_speed",
        "profiles_published-1", "path_published-1", "profiles_raw-1", "path_raw-1",
        "tension_raw-1_0", "clip_raw-1_0", "frames_raw-1_0", "clip_raw-1_1", "frames_raw-1_1",
    }  # fmt: skip
    for path in (report / "figures").glob("*.svg"):
        ElementTree.parse(path)
    assert [p.name for p in report.parent.iterdir()] == [report.name]


def test_the_same_numbers_stand_everywhere(report, tree):
    read_back = store.read_tree(report / "results.nc")
    assert read_back.identical(tree)
    with (report / "table2.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    errors = {
        (r["case"], r["quantity"], r["model"]): r for r in json.loads((report / "errors.json").read_text())["rows"]
    }
    html = (report / "report.html").read_text(encoding="utf-8")
    book = nbformat.read(report / "report.ipynb", as_version=4)
    outputs = [o for cell in book.cells for o in cell.get("outputs", ()) if "text/html" in o.get("data", {})]
    in_book = "\n".join(o.data["text/html"] for o in outputs)
    assert len(rows) == len(errors) == 24
    for row in rows:
        error = errors[row["case"], row["quantity"], row["model"]]
        for name in ("M", "S", "E", "E_percent", "u_val", "u_D", "bound_percent"):
            value = float(row[name]) if row[name] else None
            assert value == error[name]
            if value is not None and name != "u_D":
                assert f'<data value="{value!r}">' in html
                assert f'<data value="{value!r}">' in in_book
    for sentence in tables.statements(tree):
        assert sentence.replace("<tol", "&lt;tol").replace("1e-9>", "1e-9&gt;") in html


def test_the_provenance_is_the_study_s(report, results):
    assert json.loads((report / "provenance.json").read_text()) == results.provenance


def test_nothing_of_this_machine_is_in_it(report):
    needles = [str(ROOT), str(report), str(Path.home()), sys.prefix, "iopub", "/site-packages"]
    for name, data in contents(report).items():
        for needle in needles:
            assert needle.encode() not in data, (name, needle)


def test_the_notebook_is_thin_clean_and_executed(report):
    book = nbformat.read(report / "report.ipynb", as_version=4)
    nbformat.validate(book)
    code = [cell for cell in book.cells if cell.cell_type == "code"]
    assert all(len(cell.source.splitlines()) <= 6 for cell in code)
    assert [cell.execution_count for cell in code] == list(range(1, len(code) + 1))
    assert not [o for cell in code for o in cell.outputs if o.output_type in ("stream", "error")]
    assert book.metadata.kernelspec.name == "python3"
    shown = [o.data["image/svg+xml"] for cell in code for o in cell.outputs if "image/svg+xml" in o.get("data", {})]
    files = [p.read_text(encoding="utf-8").split("\n", 1)[1] for p in (report / "figures").glob("*.svg")]
    assert sorted(shown) == sorted(files)


class Page(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.ids: list[str] = []
        self.links: list[str] = []
        self.headings: list[int] = []
        self.tags: dict[str, int] = {}

    def handle_starttag(self, tag, attrs):
        attributes = dict(attrs)
        self.tags[tag] = self.tags.get(tag, 0) + 1
        if "id" in attributes:
            self.ids.append(attributes["id"])
        self.links += [attributes[name] for name in ("src", "href", "xlink:href", "srcset") if name in attributes]
        if re.fullmatch("h[1-6]", tag):
            self.headings.append(int(tag[1]))


def test_the_page_is_one_file_in_good_order(report):
    html = (report / "report.html").read_text(encoding="utf-8")
    page = Page()
    page.feed(html)
    assert len(page.ids) == len(set(page.ids))
    assert all(link.startswith(("#", "data:")) for link in page.links), page.links
    assert {link[1:] for link in page.links if link.startswith("#")} <= set(page.ids)
    assert "script" not in page.tags
    assert "url(http" not in html
    assert "@import" not in html
    assert page.tags["figure"] == 14
    assert page.tags["table"] == 4
    assert page.headings[0] == 1
    assert page.headings.count(1) == 1
    assert all(after <= before + 1 for before, after in zip(page.headings, page.headings[1:], strict=False))
    assert '<html lang="en">' in html
    assert "import figures" not in html  # inputs are hidden
    assert "A made-up study &amp; its &lt;report&gt;" in html
    assert "<strong>SYNTHETIC.</strong>" in html


def test_the_cases_curves_stand_under_along_the_contact(report):
    html = (report / "report.html").read_text(encoding="utf-8")
    sections = re.split("<h2", html)
    contact = next(section for section in sections if section.partition(">")[2].startswith("Along the contact"))
    for case in report_study.MEASURED:
        assert f'id="contact-{case}"' in contact


def test_a_second_report_replaces_the_first_whole_and_alike(report, results, tmp_path):
    folder = tmp_path / "made-up"
    earlier(folder)
    dead = tmp_path / ".made-up.part-999999999"  # above every process id: what a killed process left
    dead.mkdir()
    write.write_report(results, folder)
    assert contents(folder) == contents(report)
    assert [p.name for p in tmp_path.iterdir()] == ["made-up"]


def test_a_study_without_raw_data_has_a_report_too(tmp_path):
    folder = tmp_path / "new" / "published"
    write.write_report(report_study.published_only(), folder)
    html = (folder / "report.html").read_text(encoding="utf-8")
    assert "SYNTHETIC" not in html
    assert "Recordings" not in html
    assert (folder / "figures" / "fig13a_tension.svg").is_file()


def test_a_killed_process_leaves_the_earlier_report_untouched(tmp_path):
    folder = tmp_path / "made-up"
    before = earlier(folder)
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "tests")])}
    process = subprocess.Popen([sys.executable, "-c", SCRIPT, str(folder)], env=environment)
    part = tmp_path / f".made-up.part-{process.pid}"
    deadline = time.monotonic() + 60
    while not (part / "errors.json").exists() and time.monotonic() < deadline and process.poll() is None:
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    assert contents(folder) == before
    assert {p.name for p in tmp_path.iterdir()} == {"made-up", part.name}


def test_a_failing_step_leaves_the_earlier_report_and_nothing_else(results, tmp_path, monkeypatch):
    folder = tmp_path / "made-up"
    before = earlier(folder)

    def fail(*_):
        raise RuntimeError("the kernel died")

    monkeypatch.setattr(notebook, "execute", fail)
    with pytest.raises(RuntimeError, match="the kernel died"):
        write.write_report(results, folder)
    assert contents(folder) == before
    assert [p.name for p in tmp_path.iterdir()] == ["made-up"]


def test_a_report_set_aside_by_a_stopped_exchange_comes_back(results, tmp_path, monkeypatch):
    before = earlier(tmp_path / ".made-up.earlier")
    monkeypatch.setattr(notebook, "execute", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        write.write_report(results, tmp_path / "made-up")
    assert contents(tmp_path / "made-up") == before


def test_exchange_in_two_steps_where_the_system_has_no_other(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "platform", "other")
    earlier(tmp_path / "made-up")
    (tmp_path / "part").mkdir()
    (tmp_path / "part" / "report.html").write_text("the new report")
    atomic._exchange(tmp_path / "part", tmp_path / "made-up")
    assert contents(tmp_path / "made-up") == {"report.html": b"the new report"}
    assert [p.name for p in tmp_path.iterdir()] == ["made-up"]


def test_a_folder_with_other_files_is_not_replaced(results, tmp_path):
    (tmp_path / "thesis.docx").write_text("years of work")
    with pytest.raises(InputError, match=r"holds 'thesis\.docx', which is not part of a report; a new or empty folder"):
        write.write_report(results, tmp_path)
    assert contents(tmp_path) == {"thesis.docx": b"years of work"}


def test_a_file_in_the_way_is_named(results, tmp_path):
    (tmp_path / "out").write_text("")
    with pytest.raises(InputError, match="a file, not a folder"):
        write.write_report(results, tmp_path / "out")
    with pytest.raises(InputError, match="cannot be written"):
        write.write_report(results, tmp_path / "out" / "below")
