"""Bytes of a log that belong to no message."""

from dataclasses import dataclass

from unbend.ingest import messages
from unbend.ingest.limits import BYTES_OF_PLACE, FREE_PLACES
from unbend.messages import Ledger


@dataclass
class DamagedBytes:
    """Counts of the bytes that belong to no message.

    bad_bytes : how many are between messages.
    first_bad : the place of the first of these, -1 without any.
    cut_bytes : those of a last message that the end of the file cuts off.
    places : at how many places the next message had to be searched.
    unread_from : the place from which on the file is not read; -1 where all of it is.
    """

    bad_bytes: int = 0
    first_bad: int = -1
    cut_bytes: int = 0
    places: int = 0
    unread_from: int = -1

    def drop(self, begin: int, end: int) -> None:
        """Count the bytes of the file from ``begin`` to ``end``, which belong to no message."""
        self.bad_bytes += end - begin
        if self.first_bad < 0:
            self.first_bad = begin

    def drop_searched(self, begin: int, end: int) -> None:
        """Count bytes that belong to no message, and the search that found the next message."""
        self.drop(begin, end)
        self.places += 1

    def is_hopeless(self, size: int) -> bool:
        """Whether a file of ``size`` bytes has more places of damage than are searched."""
        return self.places > FREE_PLACES + size // BYTES_OF_PLACE

    def give_up(self, place: int, size: int) -> int:
        """Count all bytes from ``place`` on as damage; returns ``size``, the end of the file."""
        self.unread_from = place
        self.drop(place, size)
        return size

    def report_bytes(self, ledger: Ledger, name: str, unit: str) -> None:
        """Add the counts to the ledger, if there are any.

        ``name`` is that of the file, ``unit`` the word of its format for a message.
        """
        if self.bad_bytes:
            ledger.add(
                messages.bad_bytes(file=name, first=self.first_bad, count=self.bad_bytes, unit=unit)
            )
        if self.unread_from >= 0:
            ledger.add(
                messages.too_much_damage(file=name, first=self.unread_from, places=self.places)
            )
        if self.cut_bytes:
            ledger.add(messages.cut_off(file=name, count=self.cut_bytes, unit=unit))
