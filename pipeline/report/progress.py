"""Telling a person that work goes on: silence for two seconds, then a bar."""

from __future__ import annotations

import threading
from typing import Protocol

from rich.console import Console
from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bar

from pipeline.interrupts import held_back

PATIENCE_S = 2.0


class Progress(Protocol):
    """What a stage may say of itself."""

    def say(self, what: str) -> None:
        """Name a step of unknown length."""

    def begin(self, what: str, total: int) -> None:
        """Begin a step of known length."""

    def advance(self, count: int) -> None:
        """So much more of it is done."""


class Silent:
    """Says nothing."""

    def say(self, what: str) -> None:
        """Nothing."""

    def begin(self, what: str, total: int) -> None:
        """Nothing."""

    def advance(self, count: int) -> None:
        """Nothing."""


class PatientBar:
    """A bar that appears once the work has taken two seconds, and leaves no trace."""

    def __init__(self, console: Console, title: str) -> None:
        self._title = title
        self._bar = Bar(
            TextColumn("{task.description}"),
            BarColumn(bar_width=24),
            TaskProgressColumn(),
            TimeRemainingColumn(compact=True),
            console=console,
            transient=True,
        )
        self._task = self._bar.add_task(title, total=None)
        self._timer = threading.Timer(PATIENCE_S, self._appear)
        self._timer.daemon = True
        self._lock = threading.Lock()
        self._over = False

    def __enter__(self) -> PatientBar:
        if self._bar.console.is_terminal:
            with held_back():
                self._timer.start()
        return self

    def __exit__(self, *_: object) -> None:
        with held_back(), self._lock:
            self._timer.cancel()
            self._over = True
            if self._bar.live.is_started:
                self._bar.stop()

    def _appear(self) -> None:
        # The timer may have run out just as the work ended: then it comes too late to be cancelled.
        with self._lock:
            if not self._over:
                self._bar.start()

    def say(self, what: str) -> None:
        """Name a step of unknown length."""
        self._bar.update(self._task, description=f"{self._title}: {what}", total=None)

    def begin(self, what: str, total: int) -> None:
        """Begin a step of known length."""
        self._bar.reset(self._task, description=f"{self._title}: {what}", total=total)

    def advance(self, count: int) -> None:
        """So much more of it is done."""
        self._bar.advance(self._task, count)

    def show(self, what: str, done: int, total: int) -> None:
        """A step, how much of it is done, and of how much."""
        self._bar.update(
            self._task, description=f"{self._title}: {what}", completed=done, total=total or None
        )
