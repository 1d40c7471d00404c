"""One seedable mutator of logs, and what has to be true of a log that was mutated.

A mutation is three numbers: which of a format's small logs, which kind of damage, which seed. The
same three give the same bytes on every machine.

`Trial` reads mutated logs in this process, under a limit of time and of memory. Python's
Mersenne twister is used because its numbers for a seed are promised not to change.
"""

import contextlib
import random
import resource
import signal
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from unbend.errors import LogError
from unbend.ingest import Log

KINDS = ("truncate", "flip_bit", "overwrite_16", "zero_4k", "delete", "duplicate")
REFUSALS = {"LOG-FORMAT", "LOG-NO-MESSAGES", "LOG-EMPTY"}  # of logs of every format
LONGEST = 4096  # bytes deleted or doubled at once
MEMORY_BYTES = 128 << 20  # what a damaged log may need beyond a whole one
GRACE = 100.0  # work units; the limit is this plus ten times what the whole log takes


class Recipe(NamedTuple):
    """Which log of a format, which kind of damage (an index of `KINDS`), which seed."""

    file: int
    kind: int
    seed: int

    def __str__(self):
        return f"({self.file}, {self.kind}, {self.seed})  # {KINDS[self.kind]}"


def mutated(data, kind, seed):
    """The bytes of a log after one damage."""
    draw = random.Random(seed * len(KINDS) + kind)
    place = draw.randrange(len(data))
    name = KINDS[kind]
    if name == "truncate":
        return data[:place]
    if name == "flip_bit":
        flipped = data[place] ^ 1 << draw.randrange(8)
        return data[:place] + bytes([flipped]) + data[place + 1 :]
    if name == "overwrite_16":
        end = min(place + 16, len(data))
        return data[:place] + draw.randbytes(end - place) + data[end:]
    if name == "zero_4k":
        end = min(place + 4096, len(data))
        return data[:place] + bytes(end - place) + data[end:]
    end = place + draw.randint(1, LONGEST)
    if name == "delete":
        return data[:place] + data[end:]
    return data[:end] + data[place:]


def recipes(files, count, first_seed=0) -> Iterator[Recipe]:
    """That many mutations: files and kinds take turns, every seed is used once."""
    for number in range(count):
        turn = first_seed + number
        yield Recipe(turn % files, turn // files % len(KINDS), turn)


def work_unit_s():
    """CPU time [s] of a million steps of a Python loop here and now: 0.03 to 0.1 s.

    Limits of time are multiples of it, so that no test depends on the machine or on its load.
    """
    begin = time.process_time()
    total = 0
    for k in range(1_000_000):
        total += k & 3
    return time.process_time() - begin


class Hang(Exception):  # noqa: N818
    """Reading took longer than it may."""


@contextlib.contextmanager
def limited(seconds):
    """A limit of CPU time for what runs inside."""

    def stop(_, __):
        raise Hang(f"still reading after {seconds:.1f} s")

    kept = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, kept)


def peak_bytes():
    """The most memory that this process has ever had."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def damage_reported(log):
    """Whether a log says that something of it was lost, repaired or is doubtful."""
    is_told = any(entry.kind in ("loss", "warning") for entry in log.ledger)
    return bool(log.bad_bytes or log.lost_messages or is_told)


def fewer(log, whole: Log):
    """How many messages of the whole log are not in this one, type by type."""
    return (Counter(whole.messages) - Counter(log.messages)).total()


def renamed(log, whole: Log):
    """Whether there are as many messages as in the whole log, but under other names."""
    return sum(log.messages.values()) == sum(whole.messages.values())


@dataclass
class Trial:
    """Reads mutations of the small logs of one format and keeps count of how they end.

    Parameters
    ----------
    logs : the bytes of the small logs. They must read without loss or warning.
    suffix : the extension of the format.
    read : the reader, `open_log`.
    folder : where to put the one file that is rewritten for each mutation.

    ``ends`` counts ``complete``, ``reported`` (salvaged, and said so), ``renamed`` (as many
    messages, but of other names), ``unreported`` (messages are gone and nothing says so) and the
    codes of refusals; ``unreported`` lists those recipes, and ``failures`` all that must never be:
    other exceptions, hangs and memory without bound.
    """

    logs: Sequence[bytes]
    suffix: str
    read: Callable[[Path], Log]
    folder: Path
    ends: Counter[str] = field(default_factory=Counter)
    unreported: list[Recipe] = field(default_factory=list)
    failures: list[str] = field(default_factory=list)

    def __post_init__(self):
        self.path = self.folder / f"mutated{self.suffix}"
        self.whole: list[Log] = []
        self.limit_s: list[float] = []
        grace_s = GRACE * work_unit_s()
        for data in self.logs:
            self.path.write_bytes(data)
            self.read(self.path)  # imports and caches are not the log's time
            begin = time.process_time()
            whole = self.read(self.path)
            self.limit_s.append(grace_s + 10.0 * (time.process_time() - begin))
            self.whole.append(whole)

    def run(self, recipe):
        """Read one mutation; how it ended."""
        data = mutated(self.logs[recipe.file], recipe.kind, recipe.seed)
        return self.examine(recipe.file, data, recipe)

    def examine(self, file, data, name):
        """Read these bytes in place of a log; how it ended."""
        self.path.write_bytes(data)
        before = peak_bytes()
        try:
            with limited(self.limit_s[file]):
                end = self._end(file, self.read(self.path), name)
        except LogError as error:
            end = error.code
        except Exception as error:  # whatever it is, it is a bug: that is the test
            end = "failed"
            self.failures.append(f"{name}: {type(error).__name__}: {error}")
        more_bytes = peak_bytes() - before
        if more_bytes > MEMORY_BYTES:
            self.failures.append(f"{name}: {more_bytes >> 20} MiB more than before")
        self.ends[end] += 1
        return end

    def _end(self, file, log, name):
        for channel in log.channels:
            channel.__post_init__()  # shapes, and time that rises
        if damage_reported(log):
            return "reported"
        if fewer(log, self.whole[file]) == 0:
            return "complete"
        if renamed(log, self.whole[file]):
            return "renamed"
        if isinstance(name, Recipe):
            self.unreported.append(name)
        return "unreported"

    def summary(self):
        """The count of each end, and the recipes that failed."""
        ends = ", ".join(f"{count} {end}" for end, count in sorted(self.ends.items()))
        return "\n".join([f"{self.ends.total()} mutations: {ends}", *self.failures[:20]])
