"""Power-ups of a vehicle, and UTC minus time since boot of each, for all log formats.

Places in a log rise: bytes, or numbers of messages. Few of its records carry UTC.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from unbend.errors import Counted
from unbend.flight import clock
from unbend.flight.channels import TimeArray
from unbend.ingest import messages
from unbend.ingest.utc_evidence import (
    DAY_NS,
    ClockAssessment,
    Witness,
    date_text,
    is_possible,
    missed_rollovers,
)
from unbend.messages import Ledger
from unbend.units import Integers, Mask, Rows

LOWEST_FIX = 3  # 3D; both GPS_FIX_TYPE of MAVLink and GPS.Status of ArduPilot
RECORDER_APART_S = 60.0  # a recorder set by a network is seconds off, one set by hand may be hours
_BLOCK = 65_536  # rows of the running median at once
_FEWEST_RECORDS = 10  # without a second between them, of sensors; parameters come one by one

# Places of records in the log, rising, and their times since boot [ns].
Stamps = tuple[Integers, TimeArray]


class Silences(NamedTuple):
    """Times in which nothing was recorded: the stretch ``after`` each, and how long [ns]."""

    after: Rows
    length_ns: TimeArray


@dataclass(frozen=True)
class Timeline:
    """Stretches of a log in which the time since boot runs on, (n,) in the order of the log."""

    first: Integers  # place of the first record
    begin: TimeArray  # time since boot of the first record [ns]
    end: TimeArray  # that of the last record [ns]
    length: Integers  # number of records
    stray: Mask  # whether the stretch is a glitch of the stamps
    boot: NDArray[np.int16]  # number of the power-up, from 0

    @property
    def boots(self) -> int:
        """How many power-ups there are, at least 1."""
        if not self.boot.size:
            return 1
        return int(self.boot.max()) + 1

    def boot_of(self, places: Integers) -> NDArray[np.int16]:
        """The power-up to which records belong, from 0."""
        if self.boots == 1:
            return np.zeros(places.shape, np.int16)
        return np.asarray(self.boot[self._stretch(places)], np.int16)

    def good(self, places: Integers) -> Mask:
        """Which records, by their places, have a stamp that is no glitch."""
        if not self.stray.any():
            return np.ones(places.shape, np.bool_)
        return np.asarray(~self.stray[self._stretch(places)], np.bool_)

    def silences(self) -> Silences:
        """The silences between stretches that are no glitches."""
        steady = np.flatnonzero(~self.stray)
        silence_ns = self.begin[steady][1:] - self.end[steady][:-1]
        is_long = silence_ns > clock.BOOT_STEP_NS
        return Silences(steady[1:][is_long], silence_ns[is_long])

    def _stretch(self, places: Integers) -> Rows:
        """The stretches in which records lie, by their places."""
        return np.maximum(np.searchsorted(self.first, places, side="right") - 1, 0)


def microseconds(raw: NDArray[Any]) -> TimeArray:
    """Time fields of any type as a new int64 array [us]; what no log can last is cut at `LAST_US`.

    >>> microseconds(np.array([7, 2**64 - 1], np.uint64)).tolist() == [7, 2**52]
    True
    """
    if raw.dtype.kind == "f":
        known = np.nan_to_num(raw, nan=clock.LAST_US)
        return np.asarray(known.clip(0, clock.LAST_US), np.int64)
    # what is below 0 becomes huge
    unsigned = raw.astype(np.uint64, copy=False)
    return np.asarray(np.minimum(unsigned, np.uint64(clock.LAST_US)).view(np.int64), np.int64)


def nanoseconds(raw: NDArray[Any]) -> TimeArray:
    """Time fields in microseconds as a new array in nanoseconds, cut as by `microseconds`."""
    time_ns = microseconds(raw)
    time_ns *= 1000
    return time_ns


class _Stretch(NamedTuple):
    """Records whose times since boot [ns] run on; ``first`` is the place of the first of them."""

    first: int
    begin: int
    end: int
    length: int


def _stretches_of(places: Integers, time_ns: TimeArray) -> list[_Stretch]:
    """The stretches of some records, at least one, that follow each other in a log."""
    cuts = np.flatnonzero(np.abs(np.diff(time_ns)) > clock.BOOT_STEP_NS) + 1
    starts = np.append(0, cuts)
    stops = np.append(cuts, time_ns.shape[0])
    columns = (places[starts], time_ns[starts], time_ns[stops - 1], stops - starts)
    return [_Stretch(*row) for row in np.stack(columns, axis=1).tolist()]


def timeline(blocks: Iterable[Stamps]) -> Timeline:
    """Find power-ups and stray stamps in all times since boot of a log, in its order.

    A step back by more than 1 s is a power-up, unless it belongs to a stray stretch.

    >>> time_ns = np.array([5, 6, 7, 8, 9, 2, 3, 4, 5, 6]) * 10**9
    >>> timeline([(np.arange(10), time_ns)]).boot_of(np.array([4, 5]))
    array([0, 1], dtype=int16)
    """
    stretches: list[_Stretch] = []
    for places, time_ns in blocks:
        if not places.shape[0]:
            continue
        new_stretches = _stretches_of(places, time_ns)
        if stretches and abs(new_stretches[0].begin - stretches[-1].end) <= clock.BOOT_STEP_NS:
            continuation = new_stretches.pop(0)
            last = stretches[-1]
            records = last.length + continuation.length
            stretches[-1] = last._replace(end=continuation.end, length=records)
        stretches += new_stretches
    first, begin, end, length = np.array(stretches, np.int64).reshape(-1, 4).T.copy()
    stray = clock.stray_stretches(begin, end, length)
    boot = _boots(begin, end, stray)
    return Timeline(
        first=first,
        begin=begin,
        end=end,
        length=length,
        stray=stray,
        boot=boot,
    )


def _boots(begin: TimeArray, end: TimeArray, stray: Mask) -> NDArray[np.int16]:
    """The boot of each of (n,) stretches; a stray one has that of the stretch before it."""
    if not begin.size:
        return np.empty(0, np.int16)
    steady = ~stray
    steps_back = begin[steady][1:] - end[steady][:-1] < -clock.BOOT_STEP_NS
    boot_of_steady = np.append(0, np.cumsum(steps_back)).astype(np.int16)
    last_steady = np.maximum(np.cumsum(steady) - 1, 0)
    return np.asarray(boot_of_steady[last_steady], np.int16)


def report_timeline(line: Timeline, ledger: Ledger) -> None:
    """Report stray stamps, and silences between records of sensors, of a log.

    The places of the log must be bytes: the reports name them.
    """
    if line.stray.any():
        first_byte = int(line.first[line.stray][0])
        count = int(line.length[line.stray].sum())
        ledger.add(messages.stray_records(byte=first_byte, count=count))
    # Stretches of few records are of parameters and texts, before and behind those of sensors.
    with_sensors = np.flatnonzero(~line.stray & (line.length >= _FEWEST_RECORDS))
    if not with_sensors.size:
        return
    silences = line.silences()
    begins_behind_first = silences.after > with_sensors[0]
    ends_before_last = silences.after <= with_sensors[-1]
    is_between = begins_behind_first & ends_before_last
    if not is_between.any():
        return
    first_byte = int(line.first[silences.after[is_between][0]])
    seconds = float(silences.length_ns[is_between].sum()) / 1e9
    count = int(np.count_nonzero(is_between))
    ledger.add(messages.nothing_logged(byte=first_byte, count=count, seconds=seconds))


@dataclass(frozen=True)
class UtcReadings:
    """UTC beside the time since boot, by one source, (n,) in the order of the log."""

    source: str  # what the rows are, in the plural
    places: Integers
    boot_ns: TimeArray
    utc_ns: TimeArray
    usable: Mask  # False where there is no UTC, or a stray stamp
    fix: NDArray[Any] = field(default_factory=lambda: np.empty(0))  # of a receiver; else empty
    one: str = ""  # what one row is, in the singular
    sigma_s: float = 0.0  # of this clock against UTC; 0 of a receiver, whose delay is added later
    why: str = "set by the GNSS receiver"  # it has this sigma
    from_gps_week: bool = False  # computed here from GPS week and seconds

    def counted(self, rows: int) -> str:
        """A number of rows of this source, in words."""
        return str(Counted(rows, self.one or self.source, self.source))

    def usable_rows(self, line: Timeline) -> "UtcReadings":
        """The rows without stray stamps, with a fix, and with another UTC than the row before."""
        good = self.usable & line.good(self.places)
        if self.fix.size:
            good &= self.fix >= LOWEST_FIX
        good_utc_ns = self.utc_ns if bool(good.all()) else self.utc_ns[good]
        good[good] = clock.new_readings(good_utc_ns)
        if bool(good.all()):
            return self
        return self.rows(good)

    def rows(self, keep: Mask) -> "UtcReadings":
        """The rows that a mask keeps; all of them are usable."""
        return replace(
            self,
            places=self.places[keep],
            boot_ns=self.boot_ns[keep],
            utc_ns=self.utc_ns[keep],
            usable=np.ones(int(np.count_nonzero(keep)), np.bool_),
            fix=np.empty(0),
        )

    def day_in(self, boot: Mask) -> int:
        """The median UTC [Unix ns] of the rows of a boot, which a mask marks."""
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
    sigma_s: float = 0.0,
    why: str = "set by the GNSS receiver",
) -> UtcReadings:
    """The UTC of the rows of a channel or topic."""
    return UtcReadings(
        source=f"rows of {name}",
        places=places,
        boot_ns=boot_ns,
        utc_ns=utc_ns,
        usable=usable,
        fix=fix,
        one=f"row of {name}",
        sigma_s=sigma_s,
        why=why,
        from_gps_week=from_gps_week,
    )


@dataclass(frozen=True)
class BootClock:
    """UTC of a clock that begins anew at each boot of ``line``.

    ``fits`` is None where no source gives UTC; ``utc_known`` False where only the recorder does.
    ``sigma_s`` [s] of UTC in the worst boot, NaN where none has UTC; ``assessments``: what each clock
    of the log is good for.
    """

    line: Timeline
    fits: tuple[clock.ClockOffset | None, ...]
    utc_known: tuple[bool, ...]
    sigma_s: float = float("nan")
    assessments: tuple[ClockAssessment, ...] = ()

    def utc(self, places: Integers, boot_ns: TimeArray) -> TimeArray:
        """UTC [ns] of times since boot at places of the log; the times where UTC is unknown."""
        offsets_ns = np.array([fit.offset_ns if fit else 0 for fit in self.fits], np.int64)
        utc_ns = offsets_ns[self.line.boot_of(places)]
        utc_ns += boot_ns  # memory has its peak here
        return utc_ns


def fit_clock(
    line: Timeline,
    sources: Sequence[UtcReadings],
    ledger: Ledger,
    recorder: UtcReadings | None = None,
    where: str = "",
    *,
    cameras: Sequence[UtcReadings] = (),
    utc_of: str = "source of UTC",
    witnesses: Sequence[Witness] = (),
) -> BootClock:
    """Fit the offset of UTC from the time since boot, for each boot, and report how well it fits.

    In each boot the one of the ``sources`` with the most rows is used, by the median of its rows;
    each other source that differs by more than 1 s is a loss. ``cameras`` are used if no source has
    UTC, and ``recorder`` in boots without either; a boot without any counts from 1970. ``where`` is
    the vehicle and ``utc_of`` what gives UTC in this format, in words for the reports. Dates that
    no log can have are repaired or not used; ``witnesses`` are further clocks that tell the date.

    A boot is also split where nothing was recorded for more than 1 s and the offset differs by more
    than 1 s from then on. Where the offset steps without such a silence, a clock was set.
    """
    if recorder is not None:
        recorder = _possible_recorder(recorder.usable_rows(line), line, where, ledger)
    dates = DateCheck(line, recorder, tuple(witnesses), where)
    sources = [dates.acceptable(source.usable_rows(line), ledger) for source in sources]
    if not any(source.places.size for source in sources):
        sources = [dates.acceptable(camera.usable_rows(line), ledger) for camera in cameras]
    sources = sorted(sources, key=lambda source: -source.places.size)
    boots_by_steps = line.boots
    line = _split_at_silences(line, sources if recorder is None else [*sources, recorder])
    if line.boots > boots_by_steps:
        ledger.add(messages.restarted(where=where, count=line.boots - boots_by_steps))
    chosen: list[BootUtc] = []
    for number in range(line.boots):
        place = f"{where}, boot {number}".removeprefix(", ")
        utc = _utc_of_boot(line, number, sources, recorder, place, ledger)
        if utc.fit is None:
            ledger.add(messages.no_utc(where=place, utc_of=utc_of))
        chosen.append(utc)
    sigmas_s = [utc.sigma_s for utc in chosen if utc.fit is not None]
    assessments: list[ClockAssessment] = []
    for utc in chosen:
        assessments += utc.assessments
    return BootClock(
        line,
        tuple(utc.fit for utc in chosen),
        tuple(utc.is_known for utc in chosen),
        sigma_s=max(sigmas_s, default=float("nan")),
        assessments=tuple(assessments),
    )


@dataclass(frozen=True)
class DateCheck:
    """Whether the dates that sources of UTC state are possible, by the other clocks of the log."""

    line: Timeline
    recorder: UtcReadings | None
    witnesses: tuple[Witness, ...]
    where: str

    def acceptable(self, source: UtcReadings, ledger: Ledger) -> UtcReadings:
        """The rows of a source in the boots whose date can be accepted, repaired where it can be.

        A clock that nothing has set (``sigma_s`` above 0) is not accepted against a recorder that
        is more than a day away.
        """
        boots = self.line.boot_of(source.places)
        utc_ns = source.utc_ns
        keep = np.ones(boots.shape, np.bool_)
        for number in np.unique(boots).tolist():
            rows = boots == number
            stated_ns = source.day_in(rows)
            clocks = self._clocks_of(number)
            rollovers = missed_rollovers(stated_ns, clocks)
            place = f"{self.where}, boot {number}".removeprefix(", ")
            words = source.counted(int(np.count_nonzero(rows)))
            if rollovers is None or self._is_unset(source, stated_ns, clocks):
                keep &= ~rows
                ledger.add(
                    messages.utc_not_accepted(
                        where=place, source=words, stated=date_text(stated_ns), clocks=clocks
                    )
                )
            elif rollovers:
                utc_ns = utc_ns.copy() if utc_ns is source.utc_ns else utc_ns
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
        """The other clocks that tell the date of a boot, the strongest first."""
        strong = [witness for witness in self.witnesses if not witness.is_weak]
        weak = [witness for witness in self.witnesses if witness.is_weak]
        if self.recorder is not None:
            rows = self.line.boot_of(self.recorder.places) == boot
            if rows.any():
                strong.append(Witness(self.recorder.source, self.recorder.day_in(rows)))
        return strong + weak

    @staticmethod
    def _is_unset(source: UtcReadings, stated_ns: int, clocks: Sequence[Witness]) -> bool:
        """Whether a clock that no receiver has set contradicts the strongest other clock."""
        if not source.sigma_s or not clocks or clocks[0].is_weak:
            return False
        return abs(stated_ns - clocks[0].time_ns) > DAY_NS


def _possible_recorder(
    recorder: UtcReadings, line: Timeline, where: str, ledger: Ledger
) -> UtcReadings:
    """The rows of a recorder in the boots in which its date is possible."""
    boots = line.boot_of(recorder.places)
    keep = np.ones(boots.shape, np.bool_)
    for number in np.unique(boots).tolist():
        rows = boots == number
        stated_ns = recorder.day_in(rows)
        if is_possible(stated_ns):
            continue
        keep &= ~rows
        ledger.add(
            messages.utc_not_accepted(
                where=f"{where}, boot {number}".removeprefix(", "),
                source=recorder.counted(int(np.count_nonzero(rows))),
                stated=date_text(stated_ns),
                clocks=(),
            )
        )
    return recorder if bool(keep.all()) else recorder.rows(keep)


def _split_at_silences(line: Timeline, sources: Sequence[UtcReadings]) -> Timeline:
    """Split boots at silences where the offset of a source steps; the best sources come first.

    A source with rows on both sides of a silence, in one boot, decides about it.
    """
    unsplit_line = line
    silence_places = line.first[line.silences().after]
    is_decided = np.zeros(silence_places.shape, np.bool_)
    for source in sources:
        line = _split_boots(line, source, is_decided)
        is_decided |= _has_both_sides(source, unsplit_line, silence_places)
    return line


def _has_both_sides(source: UtcReadings, line: Timeline, silence_places: Integers) -> Mask:
    """Whether a source has rows of the same boot before and behind each silence."""
    boots = line.boot_of(source.places)
    # -1 stands for no row before a silence, -2 for none behind it
    padded_boots = np.concatenate([[-1], boots, [-2]]).astype(np.int64)
    rows_before = np.searchsorted(source.places, silence_places)
    return np.asarray(padded_boots[rows_before] == padded_boots[rows_before + 1])


def _split_boots(line: Timeline, source: UtcReadings, is_decided: Mask) -> Timeline:
    """Split boots where the offset of a source steps at a silence that is not decided yet."""
    silences = line.silences()
    is_within_boot = line.boot[silences.after] == line.boot[silences.after - 1]
    may_split = ~is_decided & is_within_boot
    silences = Silences(silences.after[may_split], silences.length_ns[may_split])
    if not silences.after.size or not source.places.shape[0]:
        return line
    silence_places = line.first[silences.after]
    boot = line.boot.copy()
    for before, after in _offset_steps(line, source):
        # the longest silence between the two rows is where the vehicle was restarted
        begin, end = np.searchsorted(silence_places, [before, after], side="right")
        if begin < end:
            longest = begin + np.argmax(silences.length_ns[begin:end])
            boot[silences.after[longest] :] += 1
    return replace(line, boot=boot)


def _offset_steps(line: Timeline, source: UtcReadings) -> list[tuple[int, int]]:
    """The places of the rows before and after each step of a source's offset within a boot."""
    boot = line.boot_of(source.places)
    steps: list[tuple[int, int]] = []
    for number in np.unique(boot).tolist():
        rows = np.flatnonzero(boot == number)
        places = source.places[rows]
        offset_ns = without_glitches(source.utc_ns[rows] - source.boot_ns[rows])
        stepped = np.flatnonzero(np.abs(np.diff(offset_ns)) > clock.BOOT_STEP_NS)
        steps += zip(places[stepped].tolist(), places[stepped + 1].tolist(), strict=True)
    return steps


def without_glitches(offset_ns: TimeArray) -> TimeArray:
    """The running median of offsets: steps remain, glitches of up to `STRAY_ROWS` rows do not."""
    half = min(clock.STRAY_ROWS, offset_ns.shape[0] - 1)
    if half < 1:
        return offset_ns
    padded = np.pad(offset_ns, half, mode="reflect")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1)
    steady = np.empty_like(offset_ns)
    for begin in range(0, offset_ns.shape[0], _BLOCK):  # as a whole, it would be the peak of memory
        block = slice(begin, begin + _BLOCK)
        steady[block] = np.partition(windows[block], half, axis=1)[:, half]
    return steady


def _fit_boot(line: Timeline, number: int, source: UtcReadings) -> clock.ClockOffset | None:
    """The offset of a boot by one source; None where the source has no rows in that boot."""
    rows = line.boot_of(source.places) == number
    return clock.fit_offset(source.utc_ns[rows], source.boot_ns[rows])


class BootUtc(NamedTuple):
    """UTC of a boot: its offset, whether a source states it, its sigma [s], how good each clock is."""

    fit: clock.ClockOffset | None
    is_known: bool
    sigma_s: float
    assessments: tuple[ClockAssessment, ...]


class _FittedSource(NamedTuple):
    """A source of UTC with its offset in a boot."""

    readings: UtcReadings
    fit: clock.ClockOffset

    @property
    def sigma_s(self) -> float:
        """Of the clock, and of the scatter of its rows [s]."""
        return float(np.hypot(self.readings.sigma_s, self.fit.sigma_ns / 1e9))

    def words(self) -> str:
        """The source and how many rows of it are of the boot."""
        return self.readings.counted(self.fit.rows)


def _utc_of_boot(
    line: Timeline,
    number: int,
    sources: Sequence[UtcReadings],
    recorder: UtcReadings | None,
    place: str,
    ledger: Ledger,
) -> BootUtc:
    """UTC of a boot by the source with the most rows in it, else by the recorder.

    The fit is reported, and each source that differs from it by more than 1 s; so is a recorder
    that differs by more than a minute.
    """
    fitted = _fitted(line, number, sources)
    by_recorder = _fitted(line, number, [] if recorder is None else [recorder])
    if not fitted:
        if not by_recorder:
            return _without_utc(place)
        used = by_recorder[0]
        return BootUtc(
            used.fit, False, used.sigma_s, (_assessment(used, used, used.sigma_s, place),)
        )
    used = max(fitted, key=lambda source: source.fit.rows)
    ledger.add(clock.clock_fit_note(used.words(), used.fit, place))
    for source in fitted:
        apart_ns = source.fit.offset_ns - used.fit.offset_ns
        if abs(apart_ns) > clock.BOOT_STEP_NS:
            ledger.add(
                messages.sources_disagree(
                    where=place,
                    rows=source.fit.rows,
                    source=source.words(),
                    apart_s=apart_ns / 1e9,
                    used=used.words(),
                )
            )
    sigma_s = used.sigma_s
    for other in by_recorder:
        apart_s = (other.fit.offset_ns - used.fit.offset_ns) / 1e9
        if used.readings.sigma_s:  # neither is set by a receiver: they are as good as they agree
            sigma_s = max(sigma_s, abs(apart_s))
        if abs(apart_s) > RECORDER_APART_S:
            ledger.add(
                messages.recorder_disagrees(
                    where=place,
                    recorder=other.readings.source,
                    apart_s=apart_s,
                    used=used.words(),
                )
            )
    every = [*fitted, *by_recorder]
    return BootUtc(
        used.fit,
        True,
        sigma_s,
        tuple(_assessment(source, used, sigma_s, place) for source in every),
    )


def _without_utc(place: str) -> BootUtc:
    """A boot whose UTC no clock of the log tells."""
    assessment = ClockAssessment(
        clock=f"the vehicle's time ({place})",
        use="counts from boot",
        utc=None,
        apart_s=None,
        sigma_s=None,
        why="no clock of the log tells its UTC",
    )
    return BootUtc(None, is_known=False, sigma_s=float("nan"), assessments=(assessment,))


def _fitted(line: Timeline, number: int, sources: Sequence[UtcReadings]) -> list[_FittedSource]:
    """The sources that have rows in a boot, with their offsets."""
    fitted = []
    for source in sources:
        fit = _fit_boot(line, number, source)
        if fit is not None:
            fitted.append(_FittedSource(source, fit))
    return fitted


def _assessment(
    source: _FittedSource, used: _FittedSource, sigma_s: float, place: str
) -> ClockAssessment:
    """What a source of UTC is good for, beside the one that is ``used``."""
    is_used = source is used
    return ClockAssessment(
        clock=f"{source.words()} ({place})",
        use="UTC of the log" if is_used else "compared",
        utc=date_text(source.readings.utc_ns[0]) if source.readings.utc_ns.size else None,
        apart_s=(source.fit.offset_ns - used.fit.offset_ns) / 1e9,
        sigma_s=sigma_s if is_used else source.sigma_s,
        why=source.readings.why,
    )
