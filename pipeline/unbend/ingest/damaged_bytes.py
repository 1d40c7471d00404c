"""Bytes of a log that belong to no message."""

from dataclasses import dataclass

from unbend.messages import Ledger


@dataclass
class DamagedBytes:
    """Bytes outside all messages; ``cut_bytes`` of a last one that the end of the file cuts off."""

    bad_bytes: int = 0
    first_bad: int = -1
    cut_bytes: int = 0

    def drop(self, begin: int, end: int) -> None:
        """Count bytes of the file that belong to no message."""
        self.bad_bytes += end - begin
        self.first_bad = begin if self.first_bad < 0 else self.first_bad

    def report_bytes(self, ledger: Ledger, name: str, unit: str) -> None:
        """Enter them; ``name`` of the file, ``unit`` the format's word for a message."""
        if self.bad_bytes:
            what = f"{self.bad_bytes} bytes belong to no {unit}"
            where = f"{name}, first at byte {self.first_bad}"
            ledger.loss("LOG-BAD-BYTES", what, where=where, count=self.bad_bytes)
        if self.cut_bytes:
            ledger.loss("LOG-TRUNCATED", where=name, count=self.cut_bytes, unit=unit)
