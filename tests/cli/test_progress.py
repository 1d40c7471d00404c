"""A bar that waits, and never outlives its work."""

from __future__ import annotations

import io
import threading

import pytest
from rich.console import Console

from pipeline.report import progress
from pipeline.report.progress import PatientBar


class Clock:
    """A timer whose time has come when the test says so, cancelled or not."""

    def __init__(self, _seconds, function):
        self.come = function
        self.daemon = False

    def start(self):
        pass

    def cancel(self):
        pass


@pytest.fixture
def bar(monkeypatch):
    monkeypatch.setattr(threading, "Timer", Clock)
    console = Console(file=io.StringIO(), force_terminal=True, width=80)
    return PatientBar(console, "survey")


def written(bar: PatientBar) -> str:
    return bar._bar.console.file.getvalue()


def test_a_bar_appears_when_its_time_has_come(bar):
    with bar:
        bar.begin("correcting", 10)
        assert written(bar) == ""
        bar._timer.come()
        assert "survey: correcting" in written(bar)
    assert not bar._bar.live.is_started


def test_a_timer_that_runs_out_as_the_work_ends_comes_too_late(bar):
    with bar:
        bar.begin("correcting", 10)
    bar._timer.come()
    assert not bar._bar.live.is_started
    assert written(bar) == ""


def test_silence_where_nobody_looks():
    console = Console(file=io.StringIO(), force_terminal=False)
    with PatientBar(console, "survey") as bar:
        assert not bar._timer.is_alive()
    assert progress.PATIENCE_S == 2.0
