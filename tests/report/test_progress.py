"""The progress bar appears after a delay and never outlives its work."""

import io
import threading

import numpy as np
import pytest
from rich.console import Console

from unbend.report import progress
from unbend.report.progress import DelayedProgressBar


class ManualTimer:
    """A timer that a test fires, cancelled or not."""

    def __init__(self, seconds, function):
        self.seconds = seconds
        self.fire = function
        self.daemon = False

    def start(self):
        pass

    def cancel(self):
        pass


@pytest.fixture
def bar(monkeypatch):
    monkeypatch.setattr(threading, "Timer", ManualTimer)
    monkeypatch.setenv("TERM", "xterm")
    console = Console(file=io.StringIO(), force_terminal=True, width=80)
    return DelayedProgressBar(console, "survey")


def written(bar: DelayedProgressBar):
    return bar._console.file.getvalue()


def task_of(bar: DelayedProgressBar):
    """What the bar shows: its text, how much is done, and of how much."""
    (task,) = bar._bar.tasks
    return task.description, task.completed, task.total


def test_a_bar_appears_when_its_time_has_come(bar):
    with bar:
        bar.start("correcting", 10)
        assert written(bar) == ""
        assert bar._timer.seconds == progress.DELAY_S == 0.5
        bar._timer.fire()
        assert "survey: correcting" in written(bar)
    assert not bar._bar.live.is_started


def test_a_timer_that_runs_out_as_the_work_ends_comes_too_late(bar):
    with bar:
        bar.start("correcting", 10)
    bar._timer.fire()
    assert bar._bar is None
    assert written(bar) == ""


def test_the_bar_counts_each_step_from_zero_before_and_after_it_appears(bar):
    bar.start("correcting", 10)
    bar.advance(4)
    bar._timer.fire()
    bar.advance(3)
    assert task_of(bar) == ("survey: correcting", 7, 10)
    bar.start("writing the report")
    assert task_of(bar) == ("survey: writing the report", 0, None)
    bar.update("rays", 5, 20)
    assert task_of(bar) == ("survey: rays", 5, 20)
    bar.__exit__()


def test_it_says_when_kernels_are_compiled(monkeypatch):
    """Read while numba compiles, and before and after it."""
    from unbend.refraction.kernels import jit

    note = progress.CompilingNote()
    seen = []

    class Names(list):
        def append(self, name):
            super().append(name)
            seen.append((name, str(note)))

    monkeypatch.setattr(jit, "COMPILING", Names())
    monkeypatch.setattr(jit, "cache_folder", lambda: None)
    x = np.ones(2)
    assert str(note) == ""
    kernel = jit.entry(doubled)
    kernel(x)
    assert ("doubled", " (compiling, once)") in seen
    assert str(note) == ""
    seen.clear()
    kernel(x)
    assert (seen, x.tolist()) == ([], [4.0, 4.0])


def doubled(x):
    for i in range(x.size):
        x[i] = 2.0 * x[i]


def test_a_dumb_terminal_gets_a_line_for_each_step(bar, monkeypatch):
    monkeypatch.setenv("TERM", "dumb")
    with bar:
        bar.start("reading")
        bar._timer.fire()
        bar.start("correcting", 10)
        bar.advance(10)
    assert written(bar) == "survey: reading ...\nsurvey: correcting ...\n"


def test_no_bar_where_output_is_not_a_terminal():
    console = Console(file=io.StringIO(), force_terminal=False)
    for terminal in (console, None):
        with DelayedProgressBar(terminal, "survey") as bar:
            assert not bar._timer.is_alive()
            bar.start("correcting", 10)
            bar.advance(1)
