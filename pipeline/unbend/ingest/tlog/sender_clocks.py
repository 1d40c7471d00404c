"""The clocks of a telemetry log: each sender's boots, and its time in UTC.

Messages carry time since boot; SYSTEM_TIME ties that to UTC. The log's stamps are of the ground
station, seconds off UTC and irregular by the radio link: they place messages without a time among
those with a time. Cameras and gimbals have no SYSTEM_TIME: the reception of their messages shows
whether they count by the autopilot's clock or by their own.
"""

from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from unbend.flight.channels import TimeArray
from unbend.flight.clock import BOOT_STEP_NS, clock_map, stray_times
from unbend.flight.survey_dates import DAY_NS
from unbend.ingest.boot_clock import BootClock, fit_clock
from unbend.ingest.limits import check_senders
from unbend.ingest.message_tables import rows_by_value
from unbend.ingest.timelines import timeline
from unbend.ingest.tlog import messages
from unbend.ingest.tlog.clock_samples import MICROSECOND, MILLISECOND, Readings
from unbend.ingest.tlog.senders import Sender
from unbend.ingest.utc_evidence import (
    UNCHECKED_SIGMA_S,
    UNCHECKED_WHY,
    ClockAssessment,
    Witness,
)
from unbend.ingest.utc_readings import UtcReadings
from unbend.messages import Ledger
from unbend.units import NANOSECONDS_PER_SECOND, Integers, Mask, Rows

WRAP_OF_MS_NS = (1 << 32) * MILLISECOND  # [ns] 49.7 days: a 32-bit count of milliseconds runs over
WRAP_OF_US_NS = (1 << 32) * MICROSECOND  # [ns] 71.6 minutes: one of microseconds


class ClockField(NamedTuple):
    """A field with a time since boot: its unit [ns], and the time [ns] after which it wraps."""

    unit_ns: int
    wrap_ns: int


CLOCK_FIELDS: Mapping[str, ClockField] = {
    "time_boot_ms": ClockField(MILLISECOND, WRAP_OF_MS_NS),
    "time_usec": ClockField(MICROSECOND, WRAP_OF_US_NS),
}

# Largest difference of a stamp, with its wraps added, from the sender's clock: exposures are
# reported up to some seconds late, and a minute is a seventieth of the shorter period.
MAX_MISFIT_NS = 60 * NANOSECONDS_PER_SECOND
# Delay of a message that is stamped on arrival: links and cameras delay by up to some seconds, the
# link's jitter is 2 s at most in real logs.
MIN_DELAY_NS = -2 * NANOSECONDS_PER_SECOND
MAX_DELAY_NS = 10 * NANOSECONDS_PER_SECOND


@dataclass(frozen=True)
class SenderClock:
    """One sender's clock and its boots in UTC.

    reading_places, boot_ns : (n,) readings each second and at each boot: place in the file, and
        time since boot. Empty for the clock of the ground station.
    clock : UTC of the times since boot.
    counts : of all readings, by boot.
    maps : functions from the ground station's clock [ns] to UTC [ns], by boot.
    stated_shift_ns : UTC minus the UTC that the sender states, by boot; empty for no shift.
    """

    reading_places: Integers
    boot_ns: TimeArray
    clock: BootClock
    counts: tuple[int, ...]
    maps: tuple[Callable[[TimeArray], TimeArray], ...]
    stated_shift_ns: tuple[int, ...] = ()

    def utc_of_stated(self, places: Integers, stated_ns: TimeArray) -> TimeArray:
        """UTC [ns] of times that the sender states as UTC: its date may be wrong by a rollover."""
        if not any(self.stated_shift_ns):
            return stated_ns
        shift_ns = np.array(self.stated_shift_ns, np.int64)
        return np.asarray(stated_ns + shift_ns[self.boot_at(places)], np.int64)

    def boot_at(self, places: Integers) -> NDArray[np.int16]:
        """The numbers of the boots at these places of the file."""
        return self.clock.line.boot_of(places)

    def _reading_before(self, places: Integers) -> Rows:
        """The row of the last reading before each place of the file; 0, the first, before all."""
        before = np.searchsorted(self.reading_places, places, side="right") - 1
        return np.maximum(before, 0)

    def boot_places(self, places: Integers, boot_ns: TimeArray) -> Integers:
        """For each message a place of the file in the boot that its time since boot belongs to.

        That is the message's own place, unless the next reading is of another boot and its time is
        nearer than that of the reading before: messages may come before the first reading of their
        boot.
        """
        if self.clock.line.boots == 1:
            return places
        before = self._reading_before(places)
        after = np.minimum(before + 1, self.reading_places.shape[0] - 1)
        from_before_ns = np.abs(boot_ns - self.boot_ns[before])
        from_after_ns = np.abs(boot_ns - self.boot_ns[after])
        is_of_next = from_after_ns < from_before_ns
        is_of_next &= self.boot_at(self.reading_places[after]) != self.boot_at(places)
        return np.asarray(np.where(is_of_next, self.reading_places[after], places), np.int64)

    def utc_of_host(self, places: Integers, host_ns: TimeArray) -> TimeArray:
        """UTC [ns] of messages without a time of their own, by the ground station's stamps [ns]."""
        if not self.reading_places.size:
            return host_ns
        boot = self.boot_at(places)
        utc_ns = host_ns.copy()
        for number in np.unique(boot).tolist():
            rows = boot == number
            utc_ns[rows] = self.maps[number](host_ns[rows])
        return utc_ns

    def utc_of_boot(
        self,
        places: Integers,
        host_ns: TimeArray,
        boot_ns: TimeArray,
        wrap_ns: int,
    ) -> TimeArray:
        """UTC [ns] of times since boot that wrap after ``wrap_ns``.

        Where no reading of the clock is known, the result is ``host_ns``, the stamps of the ground
        station.
        """
        if not self.reading_places.size:
            return host_ns
        clock_ns = np.asarray(self.boot_ns[self._reading_before(places)], np.int64)
        whole_ns = unrolled(boot_ns, clock_ns, wrap_ns)
        return self.clock.utc(places, whole_ns)


def _unchanged(host_ns: TimeArray) -> TimeArray:
    """The map of the ground station's clock to itself."""
    return host_ns


_HOST_CLOCK = SenderClock(
    reading_places=np.empty(0, np.int64),
    boot_ns=np.empty(0, np.int64),
    clock=BootClock(timeline([]), (None,), (False,)),
    counts=(0,),
    maps=(_unchanged,),
)


@dataclass(frozen=True)
class Clocks:
    """The clocks of the senders of a log that sent their time since boot.

    boots : how many power-ups the vehicle has.
    description : where the vehicle's UTC comes from, in words.
    wrong_utc : senders of images with a UTC that does not fit the time of their reception.
    utc_sigma_s : [s] of the vehicle's UTC.
    assessments : what each clock is good for.
    """

    senders: Mapping[Sender, SenderClock]
    boots: int
    description: str
    wrong_utc: frozenset[Sender] = frozenset()
    utc_sigma_s: float = UNCHECKED_SIGMA_S
    assessments: tuple[ClockAssessment, ...] = ()

    def lender(self, sender: Sender) -> Sender | None:
        """The sender that has the clock to use: this sender, else a component of its system.

        Of several components that with the most readings; None if none has a clock.
        """
        if sender in self.senders:
            return sender
        lender = None
        most_readings = -1
        for candidate, clock in self.senders.items():
            readings = sum(clock.counts)
            if candidate.system == sender.system and readings > most_readings:
                lender = candidate
                most_readings = readings
        return lender

    def clock_of(self, sender: Sender) -> SenderClock:
        """The clock to use for a sender: that of its `lender`, else that of the ground station."""
        lender = self.lender(sender)
        if lender is None:
            return _HOST_CLOCK
        return self.senders[lender]

    def advances_at(self, sender: Sender, place: int, least_ns: int) -> bool:
        """Whether a sender's clock advances by ``least_ns`` or more at a place of the file.

        That is between the readings before and from that place on; False if a boot is between
        them. True where the sender has no reading on either side.
        """
        clock = self.senders.get(sender, _HOST_CLOCK)
        row = int(np.searchsorted(clock.reading_places, place))
        if not 0 < row < clock.reading_places.shape[0]:
            return True
        boots = clock.boot_at(clock.reading_places[row - 1 : row + 1])
        is_one_boot = bool(boots[0] == boots[1])
        step_ns = int(clock.boot_ns[row] - clock.boot_ns[row - 1])
        return is_one_boot and step_ns >= least_ns


def clock_field(names: Container[str]) -> str:
    """The field with the time since boot among the fields of a message, or ""."""
    return next((name for name in CLOCK_FIELDS if name in names), "")


def unrolled(stamp_ns: TimeArray, sender_clock_ns: TimeArray, wrap_ns: int) -> TimeArray:
    """(n,) stamps [ns] of a counter that wraps after ``wrap_ns``, with the missing wraps added.

    They are added where the result is within `MAX_MISFIT_NS` of the sender's clock at that place,
    ``sender_clock_ns`` (n,).

    >>> clock_ns = np.array([WRAP_OF_US_NS + 4 * 10**9])
    >>> unrolled(np.array([5 * 10**9]), clock_ns, WRAP_OF_US_NS) - WRAP_OF_US_NS
    array([5000000000])
    """
    behind_ns = sender_clock_ns - stamp_ns
    if not behind_ns.shape[0] or int(behind_ns.max()) <= wrap_ns // 2:
        return stamp_ns  # no wrap is missing
    wraps = np.rint(behind_ns / wrap_ns).astype(np.int64)
    whole_ns = stamp_ns + wraps * wrap_ns
    fits = (wraps > 0) & (np.abs(whole_ns - sender_clock_ns) < MAX_MISFIT_NS)
    return np.asarray(np.where(fits, whole_ns, stamp_ns), np.int64)


@dataclass(frozen=True)
class KnownDates:
    """What shows the date of a log besides SYSTEM_TIME.

    systems_with_fix : systems with a GNSS receiver that has a fix: it sets the system's clock.
    witnesses : clocks outside the messages.
    """

    systems_with_fix: frozenset[int] = frozenset()
    witnesses: tuple[Witness, ...] = ()


def clocks_of(readings: Readings, ledger: Ledger, dates: KnownDates = KnownDates()) -> Clocks:
    """Fit the clocks of all senders; residuals and fallbacks are entered in the ledger.

    The vehicle is the sender with the most readings. Its clock is fitted first, and gives UTC to
    those of the other components of its system that have none (``lead_clock`` of `fit_sender`).
    """
    if not readings.size:
        ledger.add(messages.no_vehicle_time())
        return Clocks(
            senders={},
            boots=1,
            description="ground station clock",
        )
    # Copied, so that the rows of a sender are freed by themselves: memory has its peak in a fit.
    rows_of_sender = {number: rows.copy() for number, rows in rows_by_value(readings["source"])}
    check_senders(len(rows_of_sender), readings=readings.size)
    busiest_first = sorted(
        rows_of_sender, key=lambda number: rows_of_sender[number].size, reverse=True
    )
    vehicle = Sender.of_number(busiest_first[0])
    clocks: dict[Sender, SenderClock] = {}
    for number in busiest_first:
        sender = Sender.of_number(number)
        lead_clock = _HOST_CLOCK
        if sender.system == vehicle.system:
            lead_clock = clocks.get(vehicle, _HOST_CLOCK)
        readings_of_sender = _in_rows(readings, rows_of_sender.pop(number))
        clocks[sender] = fit_sender(readings_of_sender, lead_clock, sender, ledger, dates)
    vehicle_clock = clocks[vehicle].clock
    assessments: list[ClockAssessment] = []
    for sender_clock in clocks.values():
        assessments += sender_clock.clock.assessments
    return Clocks(
        senders=clocks,
        boots=vehicle_clock.line.boots,
        description=_description(vehicle_clock),
        utc_sigma_s=vehicle_clock.sigma_s,
        assessments=tuple(assessments),
    )


def _description(clock: BootClock) -> str:
    """Where the UTC of the vehicle's clock comes from, in words."""
    with_utc = clock.utc_known.count(True)
    boots = len(clock.utc_known)
    if with_utc == boots:
        return "vehicle clock, set to UTC by the median of SYSTEM_TIME"
    if with_utc == 0:
        return "vehicle clock, set by the ground station's clock"
    return f"vehicle clock, set to UTC by SYSTEM_TIME in {with_utc} of {boots} boots"


def _selected(readings: Readings, are_selected: Mask) -> Readings:
    """The selected readings, not copied where these are all: memory has its peak here."""
    return readings if bool(are_selected.all()) else readings[are_selected]


def _in_rows(readings: Readings, rows: Rows) -> Readings:
    """The readings in distinct rows, not copied where these are all."""
    return readings if rows.size == readings.size else readings[rows]


def _steps_back(readings: Readings) -> bool:
    """Whether the time since boot in the readings of a sender steps back by more than 1 s."""
    steps_ns = np.diff(readings["boot_ns"])
    return bool(np.any(steps_ns < -BOOT_STEP_NS))


def overtaken(readings: Readings) -> Mask:
    """Which (n,) readings of a sender are of messages that later messages overtook.

    The time of such a reading is up to `MAX_DELAY_NS` before the newest time of the rows before. A
    restart would explain that as well: it is excluded if the sender, by the stamp of reception and
    the time since boot of the reading, was switched on before the row with the newest time.
    """
    boot_ns = readings["boot_ns"]
    host_ns = readings["host_us"] * MICROSECOND
    newest_ns = np.maximum.accumulate(boot_ns)
    rows = np.arange(boot_ns.size)
    rows[newest_ns != boot_ns] = 0
    row_of_newest = np.maximum.accumulate(rows)  # of the newest time up to each row
    late_ns = newest_ns - boot_ns
    is_late = (late_ns > BOOT_STEP_NS) & (late_ns < MAX_DELAY_NS)
    boot_by_host_ns = host_ns - boot_ns  # when the sender was switched on, by the host's clock
    was_on = boot_by_host_ns < host_ns[row_of_newest] - MAX_DELAY_NS
    return np.asarray(is_late & was_on, np.bool_)


def fit_sender(
    readings: Readings,
    lead_clock: SenderClock,
    sender: Sender,
    ledger: Ledger,
    dates: KnownDates = KnownDates(),
) -> SenderClock:
    """Fit the clock of a sender to its readings.

    UTC is that of its SYSTEM_TIME; in boots without, that at which its messages were received, by
    ``lead_clock`` (of the vehicle). SYSTEM_TIME of a system without a fix is of a clock that no
    receiver has set.
    """
    readings = _selected(readings, ~stray_times(readings["boot_ns"]))
    if _steps_back(readings):
        readings = _selected(readings, ~overtaken(readings))
    places = readings["place"]
    stamped_ns = readings["host_us"] * MICROSECOND
    boot_ns = _without_wraps(readings["boot_ns"], stamped_ns, sender, ledger)
    system_time = UtcReadings(
        source="SYSTEM_TIME messages",
        singular="SYSTEM_TIME message",
        places=places,
        boot_ns=boot_ns,
        utc_ns=readings["utc_ns"],
        usable=readings["utc_ns"] > 0,
    )
    if sender.system not in dates.systems_with_fix:
        system_time = replace(system_time, sigma_s=UNCHECKED_SIGMA_S, why=UNCHECKED_WHY)
    received = UtcReadings(
        source="stamps",
        singular="stamp",
        places=places,
        boot_ns=boot_ns,
        utc_ns=lead_clock.utc_of_host(places, stamped_ns),
        usable=np.ones(places.shape, np.bool_),
        sigma_s=UNCHECKED_SIGMA_S,
        why=UNCHECKED_WHY,
    )
    line = timeline([(places, boot_ns)])
    clock = fit_clock(line, [system_time], ledger, received, str(sender), witnesses=dates.witnesses)
    boot = clock.line.boot_of(places)
    counts = np.bincount(boot, minlength=clock.line.boots).tolist()
    _report_host_clock(clock, counts, sender, ledger)
    second = boot_ns // NANOSECONDS_PER_SECOND
    is_new = (np.diff(second) != 0) | (np.diff(boot) != 0)
    is_kept = np.append(True, is_new)  # the first of each second and of each boot
    return SenderClock(
        reading_places=places[is_kept],
        boot_ns=boot_ns[is_kept],
        clock=clock,
        counts=tuple(counts),
        maps=_maps_to_utc(stamped_ns, clock.utc(places, boot_ns), counts),
        stated_shift_ns=_shifts_of_stated(clock, system_time),
    )


def _shifts_of_stated(clock: BootClock, stated: UtcReadings) -> tuple[int, ...]:
    """UTC minus the UTC that a sender states in SYSTEM_TIME [ns], by boot; 0 up to a day.

    A difference of more than a day is a date that was repaired. The other messages of the sender
    state UTC by the same clock, and need the same shift.
    """
    usable = stated.usable_rows(clock.line)
    boots = clock.line.boot_of(usable.places)
    shifts_ns = []
    for number, fit in enumerate(clock.fits):
        rows = boots == number
        shift_ns = 0
        if fit is not None and rows.any():
            offsets_ns = np.sort(usable.utc_ns[rows] - usable.boot_ns[rows])
            middle = offsets_ns.size // 2
            shift_ns = fit.offset_ns - int(offsets_ns[middle])
        has_other_date = abs(shift_ns) > DAY_NS
        shifts_ns.append(shift_ns if has_other_date else 0)
    return tuple(shifts_ns)


def _report_host_clock(
    clock: BootClock, counts: Sequence[int], sender: Sender, ledger: Ledger
) -> None:
    """Report the boots with no other UTC than that of the reception of their messages.

    ``counts``: of the readings, by boot.
    """
    for number, fit in enumerate(clock.fits):
        if fit is not None and not clock.utc_known[number]:
            ledger.add(
                messages.set_by_host_clock(
                    sender=str(sender),
                    boot=number,
                    count=counts[number],
                    spread_ms=fit.spread_ns / 1e6,
                    sigma_s=clock.sigma_s,
                )
            )


def _maps_to_utc(
    stamped_ns: TimeArray, utc_ns: TimeArray, counts: Sequence[int]
) -> tuple[Callable[[TimeArray], TimeArray], ...]:
    """For each boot a function that maps the ground station's clock [ns] to UTC [ns].

    ``stamped_ns``, ``utc_ns``: (n,) of all readings, boot after boot. ``counts``: how many of these
    each boot has, at least one.
    """
    maps = []
    begin = 0
    for count in counts:
        rows = slice(begin, begin + count)
        maps.append(clock_map(stamped_ns[rows], utc_ns[rows]))
        begin += count
    return tuple(maps)


def _without_wraps(
    boot_ns: TimeArray, stamped_ns: TimeArray, sender: Sender, ledger: Ledger
) -> TimeArray:
    """(n,) times since boot [ns] that keep increasing where the 32-bit count of milliseconds wraps.

    A new boot starts near zero too. It differs from a wrap by ``stamped_ns``, the stamps of the
    ground station: at a wrap both clocks advance by the same, within `MAX_MISFIT_NS`. The wraps
    before a new boot stay added after it.
    """
    step_ns = np.diff(boot_ns)
    # 1 where the count wrapped, -1 where an overtaken message still has a time before that.
    wraps_in_step = np.rint(-step_ns / WRAP_OF_MS_NS).astype(np.int64)
    unexplained_ns = step_ns + wraps_in_step * WRAP_OF_MS_NS - np.diff(stamped_ns)
    is_no_wrap = np.abs(unexplained_ns) > MAX_MISFIT_NS
    wraps_in_step[is_no_wrap] = 0
    if not wraps_in_step.any():
        return boot_ns
    wraps = np.append(0, np.cumsum(wraps_in_step))
    ledger.add(messages.count_wrapped(sender=str(sender), count=int(wraps.max())))
    return np.asarray(boot_ns + wraps * WRAP_OF_MS_NS, np.int64)
