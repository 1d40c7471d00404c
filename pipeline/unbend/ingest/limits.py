"""How much a log may hold of what costs more to read than its bytes: no usual log comes near.

With these limits the time and the memory of reading grow with the bytes of the file, whatever it
holds: docs/pages/limits.md states the budget. What is beyond a limit is refused, or counted as a
loss (LOG-TOO-LARGE).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unbend.ingest import messages
from unbend.messages import Ledger

# Times are compared boot by boot: each one costs a pass over the rows. Usual logs have 1 to 10,
# those of a season joined may have thousands, each of thousands of records.
FREE_BOOTS = 1000
RECORDS_OF_BOOT = 1000  # ... and one more for so many records with a time
MAX_BOOTS = 32_000  # their numbers are int16
# Each sender of a telemetry log has a clock of its own: 1.5 ms. Usual are 2 to 10; a swarm of 255
# systems with four components each has a thousand, each of hundreds of times.
FREE_SENDERS = 500
READINGS_OF_SENDER = 100  # ... and one more for so many times of senders
# Ways in which a DataFlash log may define one message: all of them become one table. Usual are 1,
# and in a log of two versions of the firmware 2.
MAX_DEFINITIONS_OF_ONE = 32
# Times at which a type of record gets another definition: the records behind are found anew.
MAX_REDEFINITIONS = 1000
# Places of damage behind each of which the next message is searched: 0.5 ms each.
FREE_PLACES = 2000
BYTES_OF_PLACE = 1000  # ... and one more for so many bytes of the file
# Fields of all formats of a PX4 log, nested ones in each place: usual are 10,000.
MAX_FIELDS = 1 << 17
# Topics, senders and instances whose values are read: each has a channel of its own.
MAX_SERIES = 1000
# Values that a table may have if its messages lack fields: NaN in the place of each missing one.
FREE_CELLS = 4_000_000
FILLED_CELLS = 4  # ... or as many times the values that are there


@dataclass
class SeriesLimit:
    """Counts the series of a log up to `MAX_SERIES`; ``dropped``: messages of the series beyond."""

    count: int = 0
    dropped: int = 0

    def admits(self, rows: int) -> bool:
        """Whether one more series may be read, of which so many messages are there now."""
        if self.count < MAX_SERIES:
            self.count += 1
            return True
        self.dropped += rows
        return False

    def admitted(self, values: Sequence[Any], column: NDArray[Any]) -> Iterator[Any]:
        """The values of a column, each of which is a series, that may be read."""
        distinct, counts = np.unique(column, return_counts=True)
        rows_of_value = dict(zip(distinct.tolist(), counts.tolist(), strict=True))
        for value in values:
            if self.admits(rows_of_value[value]):
                yield value

    def report(self, ledger: Ledger, file: str) -> None:
        """Enter the messages of series that are not read."""
        if self.dropped:
            ledger.add(messages.too_many_series(file=file, count=self.dropped, most=MAX_SERIES))


def check_boots(boots: int, records: int) -> None:
    """Refuse a log whose time begins anew too often for its records with a time."""
    most = min(FREE_BOOTS + records // RECORDS_OF_BOOT, MAX_BOOTS)
    if boots > most:
        raise messages.too_many_boots(count=boots, most=most)


def check_senders(count: int, readings: int) -> None:
    """Refuse a telemetry log with too many senders for all the times that they sent."""
    most = FREE_SENDERS + readings // READINGS_OF_SENDER
    if count > most:
        raise messages.too_many_senders(count=count, most=most)


def check_fields(fields: int) -> None:
    """Refuse a PX4 log whose formats have too many fields together."""
    if fields > MAX_FIELDS:
        raise messages.too_many_fields(count=fields, most=MAX_FIELDS)


def check_cells(columns: int, rows: int, filled: int) -> None:
    """Refuse a table most of whose values would be missing ones; ``filled`` are there."""
    most = FREE_CELLS + FILLED_CELLS * filled
    if columns * rows > most:
        raise messages.table_too_wide(columns=columns, rows=rows, filled=filled, most=most)
