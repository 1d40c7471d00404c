"""The report of a finished run as a file of its own: a page, or a PDF that a browser prints.

The page of a run has no clock, so that the same inputs give the same bytes. A delivered one states
when the run was processed: the time of its manifest, which is written last.
"""

import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from datetime import datetime
from html import escape
from pathlib import Path

from unbend.batch import store
from unbend.batch.finished_run import messages
from unbend.batch.finished_run.export import copy_of_run, refuse_output
from unbend.batch.finished_run.later_changes import notes_on_changes
from unbend.batch.remote import Place
from unbend.batch.results import verify_run
from unbend.errors import ConfigError
from unbend.messages import Ledger
from unbend.report.cover import PROCESSED, time_of_processing
from unbend.tables.manifest.file_names import MANIFEST, REPORT

BROWSERS = (
    "chromium",
    "chromium-browser",
    "google-chrome",
    "google-chrome-stable",
    "chrome",
    "microsoft-edge",
    "msedge",
)
"""Programs that print pages as Chromium does, by their names on the path."""

_BROWSERS_OFF_THE_PATH = (  # of macOS and Windows
    "/Applications/Google Chrome.app/Contents/MacOS/Google Chrome",
    "/Applications/Chromium.app/Contents/MacOS/Chromium",
    "C:/Program Files/Google/Chrome/Application/chrome.exe",
    "C:/Program Files (x86)/Microsoft/Edge/Application/msedge.exe",
)

MARGIN_BOXES_SINCE = 131
"""The first version of Chromium that prints the heads and page numbers of a style sheet. Older
versions print their own heads: title, address, date and number."""

_PDF_START = b"%PDF"
_PDF_END = b"%%EOF"
_END_BYTES = 64  # at the end of a file, which contain the mark of its end


def deliver_report(
    run: Path | Place,
    out: Path | None,
    *,
    pdf: bool,
    browser: str | None,
    timeout_s: float,
    force: bool = False,
) -> tuple[Path, Ledger]:
    """Write the report of a run to a file, as an HTML page or with ``pdf`` as a PDF.

    Without ``out`` the file is named after the mission, in the current folder; ``force`` replaces
    it. ``browser`` is the program that prints the PDF, or its path; by default the first of
    `BROWSERS` that is installed. Refuses (ConfigError) a PDF without a browser, and a browser that
    does not print within ``timeout_s``. Returns the path of the file, and notes.
    """
    program = find_browser(browser) if pdf else ""
    folder = copy_of_run(run) if isinstance(run, Place) else run
    manifest = verify_run(folder)
    ending = ".pdf" if pdf else ".html"
    if out is None:
        out = Path(f"{manifest.run.mission}-report{ending}")
    elif out.suffix.lower() != ending:
        raise messages.report_ending(path=str(out), ending=ending)
    refuse_output(folder, out, force=force)
    ledger = Ledger()
    ledger.extend(notes_on_changes(folder, manifest))
    text = (folder / REPORT).read_text(encoding="utf-8")
    if PROCESSED not in text:
        ledger.add(messages.report_without_date(path=str(folder / REPORT)))
    time_text = time_of_processing(processed_at(run), manifest.sections.mission.time_zone)
    page = text.replace(PROCESSED, f"<dt>Processed</dt><dd>{escape(time_text)}</dd>")
    with store.atomic_write(out) as draft:
        if pdf:
            print_pdf(page, draft, program, timeout_s)
        else:
            draft.write_text(page, encoding="utf-8")
    return out, ledger


def processed_at(run: Path | Place) -> float:
    """When a run was processed [Unix s]: the time of its manifest, which it wrote last.

    In object storage that is the time of the object, not of the copy here.
    """
    if isinstance(run, Place):
        written: datetime = (run / MANIFEST).head()["last_modified"]
        return written.timestamp()
    return (run / MANIFEST).stat().st_mtime


def find_browser(named: str | None) -> str:
    """The path of the browser that is ``named``, or of an installed one if None is given.

    Refuses (REPORT-BROWSER) a browser that is not installed.
    """
    candidates = (named,) if named else (*BROWSERS, *_BROWSERS_OFF_THE_PATH)
    for candidate in candidates:
        program = shutil.which(candidate)
        if program is not None:
            return program
    if named:
        raise messages.browser_not_there(name=named)
    raise messages.no_browser(names=", ".join(BROWSERS[:3]))


def print_pdf(page: str, out: Path, browser: str, timeout_s: float) -> None:
    """Print a page of HTML to the PDF ``out``; refuses (REPORT-BROWSER) an incomplete PDF."""
    with tempfile.TemporaryDirectory(prefix="unbend-") as folder:
        source = Path(folder) / REPORT
        target = Path(folder) / "report.pdf"
        source.write_text(page, encoding="utf-8")
        command = print_command(browser, source, target, Path(folder) / "profile")
        printed = output_of_program(command, timeout_s)
        if not is_whole_pdf(target):
            last_lines = " ".join(printed.split())[-300:]
            raise messages.print_failed(browser=browser, said=last_lines or "it printed no message")
        shutil.copyfile(target, out)


def print_command(browser: str, source: Path, target: Path, profile: Path) -> list[str]:
    """The command that prints the page ``source`` to the PDF ``target``, without network.

    ``profile`` is a new folder for the settings of the browser, so that the user's are not used.
    """
    command = [
        browser,
        "--headless",
        "--disable-gpu",
        "--disable-extensions",
        "--disable-background-networking",
        "--no-first-run",
        f"--user-data-dir={profile}",
        f"--print-to-pdf={target}",
    ]
    if version_of(browser) >= MARGIN_BOXES_SINCE:
        command.append("--no-pdf-header-footer")
    if hasattr(os, "geteuid") and os.geteuid() == 0:
        command.append("--no-sandbox")  # Chromium refuses root, as in containers, without it
    return [*command, source.as_uri()]


def version_of(browser: str) -> int:
    """The main version of a browser; 0 if it does not print one."""
    try:
        version = output_of_program([browser, "--version"], timeout_s=20.0)
    except ConfigError:
        return 0
    numbers = re.search(r"(\d+)\.\d+\.\d+", version)
    return int(numbers[1]) if numbers else 0


def output_of_program(command: Sequence[str], timeout_s: float) -> str:
    """Run a program, and return what it printed.

    Refuses (REPORT-BROWSER) a program that does not start, or does not end within ``timeout_s``;
    it is then killed with all processes that it started.
    """
    is_posix = sys.platform != "win32"
    try:
        process = subprocess.Popen(
            command,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
            start_new_session=is_posix,
        )
    except OSError as error:
        raise messages.print_failed(browser=command[0], said=str(error)) from None
    try:
        printed, _ = process.communicate(timeout=timeout_s)
    except subprocess.TimeoutExpired:
        raise messages.print_too_long(browser=command[0], seconds=timeout_s) from None
    finally:
        if process.poll() is None:
            kill_program(process, is_group=is_posix)
    return printed.decode("utf-8", "replace")


def kill_program(process: subprocess.Popen[bytes], *, is_group: bool) -> None:
    """Kill a program that still runs; with ``is_group`` all processes that it started, too."""
    if is_group:
        os.killpg(process.pid, signal.SIGKILL)
    else:
        process.kill()
    process.communicate()


def is_whole_pdf(path: Path) -> bool:
    """Whether a file begins and ends as a PDF."""
    if not path.is_file():
        return False
    content = path.read_bytes()
    return content.startswith(_PDF_START) and _PDF_END in content[-_END_BYTES:]
