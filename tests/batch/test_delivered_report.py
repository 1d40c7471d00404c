"""The report as a file to hand over. Browsers are small programs that do what real ones may do."""

import json
import os
import stat
import time
from datetime import UTC, datetime
from pathlib import Path

import pytest

from tests.helpers import one_line, refused
from unbend.batch.finished_run import delivered_report
from unbend.batch.finished_run.delivered_report import (
    find_browser,
    output_of_program,
    print_command,
)
from unbend.batch.remote import Place
from unbend.report.cover import PROCESSED

pytestmark = pytest.mark.skipif(os.name != "posix", reason="the browsers here are shell scripts")

PRINTS = """
case "$1" in --version) echo "Chromium $VERSION.0.1.2"; exit 0;; esac
for word in "$@"; do
  case "$word" in --print-to-pdf=*) out="${word#--print-to-pdf=}";; file://*) page="$word";; esac
done
printf '%%PDF-1.4\\n' > "$out"; cat "${page#file://}" >> "$out"; printf '\\n%%%%EOF\\n' >> "$out"
"""


def browser(folder, script):
    path = folder / "browser"
    path.write_text("#!/bin/sh\n" + script, "utf-8")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return str(path)


def test_a_page_with_the_date_of_processing(unbend, baseline, tmp_path, monkeypatch, obeyed):
    """The time of the manifest; the results stay as they are."""
    monkeypatch.chdir(tmp_path)
    obeyed("report", baseline.output)
    page = Path(f"{baseline.manifest()['mission']}-report.html").read_text("utf-8")
    page_of_run = (baseline.output / "report.html").read_text("utf-8")
    time_utc = time.gmtime((baseline.output / "manifest.json").stat().st_mtime)
    date = f"<dt>Processed</dt><dd>{time.strftime('%Y-%m-%d %H:%M', time_utc)} UTC</dd>"
    assert page == page_of_run.replace(PROCESSED, date)
    assert date not in page_of_run
    obeyed("verify", baseline.output)
    again = unbend("report", baseline.output)
    assert again.code == 2
    assert again.err.startswith("EXPORT-EXISTS: ")
    obeyed("report", baseline.output, "--force")


@pytest.mark.parametrize(
    ("words", "code"),
    [
        ("--out {run}/x.html", "EXPORT-INSIDE-RUN"),
        ("--pdf --out x.html --browser sh", "REPORT-ENDING"),
    ],
)
def test_a_place_for_the_report_that_is_refused(
    refusal_of, baseline, tmp_path, monkeypatch, words, code
):
    monkeypatch.chdir(tmp_path)
    refusal_of(code, 2, "report", baseline.output, *words.format(run=baseline.output).split())


def test_of_results_at_a_url_the_time_is_that_of_the_object(monkeypatch):
    """The manifest of the copy here is as old as the copy."""
    written = datetime(2026, 7, 1, 10, 0, tzinfo=UTC)
    asked = []

    def head(place):
        asked.append(str(place))
        return {"last_modified": written}

    monkeypatch.setattr(Place, "head", head)
    time_s = delivered_report.processed_at(Place.of("s3://bucket/results/survey"))
    assert time_s == written.timestamp()
    assert asked == ["s3://bucket/results/survey/manifest.json"]


def test_a_pdf_is_what_the_browser_printed(obeyed, baseline, tmp_path, monkeypatch):
    monkeypatch.setenv("VERSION", "156")
    out = tmp_path / "r.pdf"
    words = ("--pdf", "--out", out, "--browser", browser(tmp_path, PRINTS), "--json")
    text = obeyed("report", baseline.output, *words)
    assert json.loads(text)["out"] == str(out)
    content = out.read_bytes()
    assert content.startswith(b"%PDF")
    assert b"<dt>Processed</dt>" in content


@pytest.mark.parametrize(
    ("script", "sentence"),
    [
        ("echo no display >&2; exit 1", "no display"),
        ("case $1 in --version) exit 0;; esac; sleep 600 & sleep 600", "did not end within 1 s"),
        (
            PRINTS.replace("printf '\\n%%%%EOF\\n' >> \"$out\"", "kill -9 $$"),
            "not write a complete PDF",
        ),
    ],
)
def test_a_browser_that_does_not_print_leaves_nothing(unbend, baseline, tmp_path, script, sentence):
    out = tmp_path / "out" / "r.pdf"
    out.parent.mkdir()
    words = ("--pdf", "--timeout", "1", "--out", out, "--browser", browser(tmp_path, script))
    began_s = time.monotonic()
    ended = unbend("report", baseline.output, *words)
    assert time.monotonic() - began_s < 60.0
    assert ended.code == 2, ended.text
    assert ended.err.startswith("REPORT-BROWSER: ")
    assert sentence in one_line(ended.err)
    assert not list(out.parent.iterdir())


def test_no_browser_is_said_with_what_to_do(refusal_of, baseline, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(delivered_report, "_BROWSERS_OFF_THE_PATH", ())
    out = tmp_path / "r.pdf"
    text = refusal_of("REPORT-BROWSER", 2, "report", baseline.output, "--pdf", "--out", out)
    for words in ("chromium", "--browser", "report.html"):
        assert words in text
    with refused("REPORT-BROWSER") as refusal:
        find_browser("nonesuch")
    refusal.match("no program 'nonesuch'")


def test_what_a_browser_started_is_ended_with_it(tmp_path):
    script = f"sleep 600 & echo $! > {tmp_path}/child; sleep 600"
    with refused("REPORT-BROWSER") as refusal:
        output_of_program([browser(tmp_path, script)], 1.0)
    refusal.match("did not end")
    child = int((tmp_path / "child").read_text())
    for _ in range(50):
        try:
            state = Path(f"/proc/{child}/stat").read_text().split()[2]
        except (OSError, IndexError):
            return
        if state == "Z":
            return
        time.sleep(0.1)
    pytest.fail("the child runs on")


@pytest.mark.parametrize(("version", "own_heads"), [("130", False), ("131", True), ("x", False)])
def test_an_older_browser_prints_heads_of_its_own(tmp_path, monkeypatch, version, own_heads):
    monkeypatch.setenv("VERSION", version)
    program = browser(tmp_path, PRINTS)
    page = tmp_path / "a.html"
    command = print_command(program, page, tmp_path / "a.pdf", tmp_path / "p")
    assert ("--no-pdf-header-footer" in command) == own_heads
    assert command[-1] == page.as_uri()


def test_a_report_of_an_older_version_is_delivered_without_a_date(
    obeyed, mission, tmp_path, plain_report
):
    """Its page has no place for the date: that is said."""
    mission.run_to_manifest()
    text = obeyed("report", mission.output, "--out", tmp_path / "r.html", "--json")
    assert [entry["code"] for entry in json.loads(text)["ledger"]] == ["REPORT-DATE"]
