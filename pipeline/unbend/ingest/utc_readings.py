"""Rows of a log with both UTC and time since boot, and the check of their dates."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unbend.errors import Counted
from unbend.flight import clock
from unbend.flight.channels import TimeArray
from unbend.flight.survey_dates import DAY_NS
from unbend.ingest import messages
from unbend.ingest.timelines import Timeline, place_of_boot
from unbend.ingest.utc_evidence import Witness, date_text, is_possible, missed_rollovers
from unbend.messages import Ledger
from unbend.units import Integers, Mask

LOWEST_FIX = 3  # 3D; both GPS_FIX_TYPE of MAVLink and GPS.Status of ArduPilot


@dataclass(frozen=True)
class UtcReadings:
    """The (n,) rows of one source with UTC and time since boot, in the order of the log."""

    source: str  # what the rows are, in the plural: "rows of GPS"
    places: Integers
    boot_ns: TimeArray
    utc_ns: TimeArray
    usable: Mask  # False where the row has no UTC, or a stray stamp
    fix: NDArray[Any] = field(default_factory=lambda: np.empty(0))  # empty if not of a receiver
    singular: str = ""  # what a row is; empty if the same as ``source``
    sigma_s: float = 0.0  # of this clock against UTC [s]; 0: a receiver, its delay is added later
    why: str = "set by the GNSS receiver"  # the reason for this sigma
    from_gps_week: bool = False  # UTC was computed by this package from GPS week and seconds

    @property
    def is_set_by_receiver(self) -> bool:
        """Whether a GNSS receiver sets this clock: its sigma is 0, its delay is added later."""
        return self.sigma_s == 0.0

    def counted(self, rows: int) -> str:
        """A number of rows of this source, in words."""
        return str(Counted(rows, self.singular or self.source, self.source))

    def usable_rows(self, line: Timeline) -> "UtcReadings":
        """The rows without stray stamps, with a fix, and with another UTC than the row before."""
        good = self.usable & line.good(self.places)
        if self.fix.size:
            good &= self.fix >= LOWEST_FIX
        good_utc_ns = self.utc_ns if bool(good.all()) else self.utc_ns[good]
        good[good] = clock.new_readings(good_utc_ns)  # of the good rows only the new ones stay good
        if bool(good.all()):
            return self
        return self.rows(good)

    def rows(self, keep: Mask) -> "UtcReadings":
        """The rows that the mask ``keep`` selects, marked as usable."""
        return replace(
            self,
            places=self.places[keep],
            boot_ns=self.boot_ns[keep],
            utc_ns=self.utc_ns[keep],
            usable=np.ones(int(np.count_nonzero(keep)), np.bool_),
            fix=np.empty(0),
        )

    def median_utc_ns(self, boot: Mask) -> int:
        """The median UTC [Unix ns] of the rows of a boot; ``boot`` (n,) is True for these rows."""
        sorted_ns = np.sort(self.utc_ns[boot])
        return int(sorted_ns[sorted_ns.size // 2])


def rows_of(
    name: str,
    *,
    places: Integers,
    boot_ns: TimeArray,
    utc_ns: TimeArray,
    usable: Mask,
    fix: NDArray[Any],
    from_gps_week: bool = False,
) -> UtcReadings:
    """The UTC of the rows of the channel or topic ``name``; ``fix``: empty if not of a receiver."""
    return UtcReadings(
        source=f"rows of {name}",
        places=places,
        boot_ns=boot_ns,
        utc_ns=utc_ns,
        usable=usable,
        fix=fix,
        singular=f"row of {name}",
        from_gps_week=from_gps_week,
    )


@dataclass(frozen=True)
class DateCheck:
    """Checks the dates of sources of UTC against the other clocks of the log.

    recorder : the rows of the recorder, None without one; witnesses : further clocks;
    where : the vehicle, for reports.
    """

    line: Timeline
    recorder: UtcReadings | None
    witnesses: tuple[Witness, ...]
    where: str

    def acceptable(self, source: UtcReadings, ledger: Ledger) -> UtcReadings:
        """The rows of a source in the boots with an acceptable date, which may be repaired.

        For each boot the date is accepted unchanged, or moved by the rollovers that it lacks, or
        rejected, which drops the rows of the boot. Moved and rejected dates are reported.
        """
        boots = self.line.boot_of(source.places)
        utc_ns = source.utc_ns
        keep = np.ones(boots.shape, np.bool_)
        for number in np.unique(boots).tolist():
            rows = boots == number
            stated_ns = source.median_utc_ns(rows)
            clocks = self._clocks_of(number)
            rollovers = missed_rollovers(stated_ns, clocks, of_receiver=source.is_set_by_receiver)
            place = place_of_boot(self.where, number)
            words = source.counted(int(np.count_nonzero(rows)))
            if rollovers is None or self._is_unset(source, stated_ns, clocks):
                keep &= ~rows
                ledger.add(
                    messages.utc_not_accepted(
                        where=place, source=words, stated=date_text(stated_ns), clocks=clocks
                    )
                )
            elif rollovers:
                if utc_ns is source.utc_ns:  # the array of the source must not be changed
                    utc_ns = utc_ns.copy()
                utc_ns[rows] = clock.later_by_rollovers(
                    utc_ns[rows], rollovers, from_gps_week=source.from_gps_week
                )
                moved_ns = int(np.median(utc_ns[rows]))
                ledger.add(
                    messages.week_rollover(
                        where=place,
                        source=words,
                        count=int(np.count_nonzero(rows)),
                        stated=date_text(stated_ns),
                        moved=date_text(moved_ns),
                        rollovers=rollovers,
                        clocks=clocks,
                    )
                )
        checked = replace(source, utc_ns=utc_ns)
        return checked if bool(keep.all()) else checked.rows(keep)

    def _clocks_of(self, boot: int) -> list[Witness]:
        """The clocks that the date of a boot is compared with, the strongest first.

        These are all witnesses, the weak ones last, and the recorder if it has rows in this boot.
        """
        strong = [witness for witness in self.witnesses if not witness.is_weak]
        weak = [witness for witness in self.witnesses if witness.is_weak]
        if self.recorder is not None:
            rows = self.line.boot_of(self.recorder.places) == boot
            if rows.any():
                strong.append(Witness(self.recorder.source, self.recorder.median_utc_ns(rows)))
        return strong + weak

    @staticmethod
    def _is_unset(source: UtcReadings, stated_ns: int, clocks: Sequence[Witness]) -> bool:
        """Whether a source that no receiver sets is more than a day off the strongest other clock.

        False if that clock is weak.
        """
        if source.is_set_by_receiver or not clocks or clocks[0].is_weak:
            return False
        return abs(stated_ns - clocks[0].time_ns) > DAY_NS


def possible_recorder(
    recorder: UtcReadings, line: Timeline, where: str, ledger: Ledger
) -> UtcReadings:
    """The rows of a recorder in the boots in which its date is possible.

    All rows of ``recorder`` must be usable. Each boot that is left out is reported.
    """
    boots = line.boot_of(recorder.places)
    keep = np.ones(boots.shape, np.bool_)
    for number in np.unique(boots).tolist():
        rows = boots == number
        stated_ns = recorder.median_utc_ns(rows)
        if is_possible(stated_ns):
            continue
        keep &= ~rows
        ledger.add(
            messages.utc_not_accepted(
                where=place_of_boot(where, number),
                source=recorder.counted(int(np.count_nonzero(rows))),
                stated=date_text(stated_ns),
                clocks=(),
            )
        )
    return recorder if bool(keep.all()) else recorder.rows(keep)
