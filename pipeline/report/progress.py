"""Progress of a command in a terminal: nothing for two seconds, then a bar."""

from __future__ import annotations

import threading
from typing import Protocol

from rich.console import Console
from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bar

from pipeline.interrupts import held_back

DELAY_S = 2.0


class Progress(Protocol):
    """What a stage reports while it runs."""

    def start(self, step: str, total: int | None = None) -> None:
        """Begin a step of ``total`` units, None if that is not known."""

    def advance(self, count: int) -> None:
        """Add ``count`` finished units to the step."""


class NoProgress:
    """Discards every report."""

    def start(self, step: str, total: int | None = None) -> None:
        """Do nothing."""

    def advance(self, count: int) -> None:
        """Do nothing."""


class DelayedProgressBar:
    """A bar that appears after two seconds of work and is erased at the end."""

    def __init__(self, console: Console, title: str) -> None:
        self._title = title
        ends = TaskProgressColumn(), TimeRemainingColumn(compact=True)
        columns = TextColumn("{task.description}"), BarColumn(bar_width=24), *ends
        self._bar = Bar(*columns, console=console, transient=True)
        self._task = self._bar.add_task(title, total=None)
        self._timer = threading.Timer(DELAY_S, self._show)
        self._timer.daemon = True
        self._lock = threading.Lock()
        self._ended = False

    def __enter__(self) -> DelayedProgressBar:
        if self._bar.console.is_terminal:
            with held_back():
                self._timer.start()
        return self

    def __exit__(self, *_: object) -> None:
        with held_back(), self._lock:
            self._timer.cancel()
            self._ended = True
            if self._bar.live.is_started:
                self._bar.stop()

    def _show(self) -> None:
        # A timer that runs out while the work ends can no longer be cancelled.
        with self._lock:
            if not self._ended:
                self._bar.start()

    def start(self, step: str, total: int | None = None) -> None:
        """Begin a step of ``total`` units, None if that is not known."""
        # A new task, since rich cannot take the total from one that has it.
        self._bar.remove_task(self._task)
        self._task = self._bar.add_task(f"{self._title}: {step}", total=total)

    def advance(self, count: int) -> None:
        """Add ``count`` finished units to the step."""
        self._bar.advance(self._task, count)

    def update(self, step: str, completed: int, total: int) -> None:
        """Set step, finished units and their total (0 if that is not known)."""
        text = f"{self._title}: {step}"
        self._bar.update(self._task, description=text, completed=completed, total=total or None)
