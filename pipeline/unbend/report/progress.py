"""Progress of a command in a terminal: nothing for half a second, then a bar."""

from __future__ import annotations

import sys
import threading
from typing import TYPE_CHECKING, Any

from unbend.interrupts import held_back
from unbend.report.words import visible

if TYPE_CHECKING:
    from rich.console import Console

DELAY_S = 0.5
"""Until the bar appears: so no command is silent for 2 s, even on an overloaded machine."""


class Progress:
    """Receives the progress of a stage and discards it; `DelayedProgressBar` shows it."""

    def start(self, step: str, total: int | None = None) -> None:
        """Begin a step of ``total`` units; None if their number is unknown."""

    def advance(self, count: int) -> None:
        """Add ``count`` finished units to the step."""


class CompilingNote:
    """A text that is " (compiling, once)" while kernels are compiled, else "".

    It is evaluated when the bar is drawn, and does not import the kernels.
    """

    def __str__(self) -> str:
        jit = sys.modules.get("unbend.refraction.kernels.jit")
        return " (compiling, once)" if jit and jit.COMPILING else ""


class DelayedProgressBar(Progress):
    """A progress bar that appears after half a second, and is erased at the end.

    Without a ``console``, or if that is not a terminal, nothing is shown. A context manager.
    """

    def __init__(self, console: Console | None, title: str) -> None:
        self._console = console
        self._title = visible(title)
        self._text = self._title
        self._completed = 0
        self._total: int | None = None
        self._bar: Any = None
        self._task: Any = None
        self._timer = threading.Timer(DELAY_S, self._show)
        self._timer.daemon = True
        self._lock = threading.Lock()
        self._ended = False

    def __enter__(self) -> DelayedProgressBar:
        if self._console is not None and self._console.is_terminal:
            with held_back():  # a signal while the timer has its lock would block for ever
                self._timer.start()
        return self

    def __exit__(self, *_: object) -> None:
        with held_back(), self._lock:
            self._timer.cancel()
            self._ended = True
            if self._bar is not None:
                self._bar.stop()

    def _show(self) -> None:
        """Show the bar; called in the timer's thread, in which rich.progress is imported.

        Most commands end before that.
        """
        from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeRemainingColumn
        from rich.progress import Progress as Bar

        # The work may have ended when the timer had just run out and could not be cancelled.
        with self._lock:
            if self._ended or self._console is None:
                return
            self._bar = Bar(
                TextColumn("{task.description}{task.fields[note]}", markup=False),
                BarColumn(bar_width=24),
                TaskProgressColumn(),
                TimeRemainingColumn(compact=True),
                console=self._console,
                transient=True,
                redirect_stdout=False,
                redirect_stderr=sys.stderr.isatty(),
                disable=self._console.is_dumb_terminal,
            )
            self._begin_task()
            self._bar.start()

    def _begin_task(self) -> None:
        """Show the step as a new task, because rich cannot remove the total of an existing task."""
        if self._task is not None:
            self._bar.remove_task(self._task)
        self._task = self._bar.add_task(
            self._text, total=self._total, completed=self._completed, note=CompilingNote()
        )
        if self._bar.disable and self._console is not None:
            self._console.print(f"{self._text} ...", markup=False, highlight=False)

    def start(self, step: str, total: int | None = None) -> None:
        """Begin a step; its bar is empty."""
        with self._lock:
            self._text = f"{self._title}: {step}"
            self._completed = 0
            self._total = total
            if self._bar is not None:
                self._begin_task()

    def advance(self, count: int) -> None:
        """Add finished units to the bar."""
        with self._lock:
            self._completed += count
            if self._bar is not None:
                self._bar.advance(self._task, count)

    def update(self, step: str, completed: int, total: int) -> None:
        """Set the step, its finished units and their total, which is 0 if it is unknown."""
        with self._lock:
            self._text = f"{self._title}: {step}"
            self._completed = completed
            self._total = total or None
            if self._bar is not None:
                self._bar.update(
                    self._task, description=self._text, completed=completed, total=self._total
                )
