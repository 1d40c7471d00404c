"""Limits of what costs much time or memory to read, compared with its bytes in the log.

No usual log comes near them. They keep time and memory proportional to the size of the file, for
any content: docs/pages/limits.md states the budget. A log beyond a limit is refused, or the part
beyond it is counted as a loss (LOG-TOO-LARGE).
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
RECORDS_OF_BOOT = 1000  # records with a time for each further boot beyond `FREE_BOOTS`
MAX_BOOTS = 32_000  # their numbers are int16
# Each sender of a telemetry log has a clock of its own: 1.5 ms. Usual are 2 to 10; a swarm of 255
# systems with four components each has a thousand, each of hundreds of times.
FREE_SENDERS = 500
READINGS_OF_SENDER = 100  # times of senders for each further sender beyond `FREE_SENDERS`
# Ways in which a DataFlash log may define one message: all of them become one table. Usual are 1,
# and in a log of two versions of the firmware 2.
MAX_DEFINITIONS_OF_ONE = 32
# How often a type of record gets another definition: the records behind it are searched anew.
MAX_REDEFINITIONS = 1000
# Places of damage; behind each the next message is searched: 0.5 ms.
FREE_PLACES = 2000
BYTES_OF_PLACE = 1000  # bytes of the file for each further place beyond `FREE_PLACES`
# Fields of all formats of a PX4 log, nested ones in each place: usual are 10,000.
MAX_FIELDS = 1 << 17
# Topics, senders and instances that are read: each becomes a separate channel.
MAX_SERIES = 1000
# Values that a table may have if its messages lack fields: NaN in the place of each missing one.
FREE_CELLS = 4_000_000
FILLED_CELLS = 4  # further values, beyond `FREE_CELLS`, for each value that is not missing


@dataclass
class SeriesLimit:
    """Counts the series (topics, senders, instances) of a log, up to `MAX_SERIES`.

    ``dropped``: how many messages belong to series beyond the limit, which are not read.
    """

    count: int = 0
    dropped: int = 0

    def admits(self, rows: int) -> bool:
        """Count one more series of so many messages (``rows``); True if it may be read."""
        if self.count < MAX_SERIES:
            self.count += 1
            return True
        self.dropped += rows
        return False

    def admitted(self, values: Sequence[Any], column: NDArray[Any]) -> Iterator[Any]:
        """Yield the ``values`` that may be read; ``column`` (n,) has the value of each message."""
        distinct, counts = np.unique(column, return_counts=True)
        rows_of_value = dict(zip(distinct.tolist(), counts.tolist(), strict=True))
        for value in values:
            if self.admits(rows_of_value[value]):
                yield value

    def report(self, ledger: Ledger, file: str) -> None:
        """Enter the number of messages that are not read, if there are any, as a loss."""
        if self.dropped:
            ledger.add(messages.too_many_series(file=file, count=self.dropped, most=MAX_SERIES))


def check_boots(boots: int, records: int) -> None:
    """Refuse (LogError) a log with too many boots for the number of its records with a time."""
    most = min(FREE_BOOTS + records // RECORDS_OF_BOOT, MAX_BOOTS)
    if boots > most:
        raise messages.too_many_boots(count=boots, most=most)


def check_senders(count: int, readings: int) -> None:
    """Refuse (LogError) a telemetry log with too many senders for the times that they sent."""
    most = FREE_SENDERS + readings // READINGS_OF_SENDER
    if count > most:
        raise messages.too_many_senders(count=count, most=most)


def check_fields(fields: int) -> None:
    """Refuse (LogError) a PX4 log if its formats have too many fields together."""
    if fields > MAX_FIELDS:
        raise messages.too_many_fields(count=fields, most=MAX_FIELDS)


def check_cells(columns: int, rows: int, filled: int) -> None:
    """Refuse (LogError) a table with too many missing values; ``filled`` values are not missing."""
    most = FREE_CELLS + FILLED_CELLS * filled
    if columns * rows > most:
        raise messages.table_too_wide(columns=columns, rows=rows, filled=filled, most=most)
