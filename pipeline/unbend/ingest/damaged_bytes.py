"""Bytes of a log that belong to no message."""

from dataclasses import dataclass

from unbend.ingest import messages
from unbend.messages import Ledger


@dataclass
class DamagedBytes:
    """Counts of the bytes that belong to no message.

    bad_bytes : how many lie between messages.
    first_bad : the place of the first of these, -1 without any.
    cut_bytes : those of a last message that the end of the file cuts off.
    """

    bad_bytes: int = 0
    first_bad: int = -1
    cut_bytes: int = 0

    def drop(self, begin: int, end: int) -> None:
        """Count the bytes of the file from ``begin`` to ``end``, which belong to no message."""
        self.bad_bytes += end - begin
        if self.first_bad < 0:
            self.first_bad = begin

    def report_bytes(self, ledger: Ledger, name: str, unit: str) -> None:
        """Add the counts to the ledger, if there are any.

        ``name`` is that of the file, ``unit`` the word of its format for a message.
        """
        if self.bad_bytes:
            ledger.add(
                messages.bad_bytes(file=name, first=self.first_bad, count=self.bad_bytes, unit=unit)
            )
        if self.cut_bytes:
            ledger.add(messages.cut_off(file=name, count=self.cut_bytes, unit=unit))
