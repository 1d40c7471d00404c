"""Power-ups of a vehicle, and UTC minus time since boot of each, for all log formats.

Places in a log rise: bytes, or numbers of messages. Few of its records carry UTC.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unbend.flight import clock
from unbend.flight.channels import TimeArray
from unbend.messages import Ledger
from unbend.units import Integers, Mask, Rows

LOWEST_FIX = 3  # 3D; both GPS_FIX_TYPE of MAVLink and GPS.Status of ArduPilot
_BLOCK = 65_536  # rows

# Places of records in the log, rising, and their times since boot [ns].
Stamps = tuple[Integers, TimeArray]


@dataclass(frozen=True)
class Timeline:
    """Stretches of a log in which the time since boot runs on, (n,) in the order of the log.

    ``first`` the place of the first record, ``begin`` and ``end`` the first and the last time since
    boot [ns], ``length`` how many records, ``stray`` whether it is a glitch, ``boot`` from 0.
    """

    first: Integers
    begin: TimeArray
    end: TimeArray
    length: Integers
    stray: Mask
    boot: NDArray[np.int16]

    @property
    def boots(self) -> int:
        return int(self.boot.max()) + 1 if self.boot.size else 1

    def boot_of(self, places: Integers) -> NDArray[np.int16]:
        """The power-up to which records belong, from 0."""
        if self.boots == 1:
            return np.zeros(places.shape, np.int16)
        return np.asarray(self.boot[self._stretch(places)], np.int16)

    def good(self, places: Integers) -> Mask:
        """Whether the stamps of records are no glitches."""
        if not self.stray.any():
            return np.ones(places.shape, np.bool_)
        return np.asarray(~self.stray[self._stretch(places)], np.bool_)

    def silences(self) -> tuple[Rows, TimeArray]:
        """The stretches before which nothing was recorded for a while, and for how long [ns]."""
        steady = np.flatnonzero(~self.stray)
        silence = self.begin[steady][1:] - self.end[steady][:-1]
        long = silence > clock.BOOT_STEP_NS
        return steady[1:][long], silence[long]

    def _stretch(self, places: Integers) -> Rows:
        return np.maximum(np.searchsorted(self.first, places, side="right") - 1, 0)


def microseconds(raw: NDArray[Any]) -> TimeArray:
    """Time fields of any type as a new int64 array [us]; what no log can last is cut at `LAST_US`.

    >>> microseconds(np.array([7, 2**64 - 1], np.uint64)).tolist() == [7, 2**52]
    True
    """
    if raw.dtype.kind == "f":
        return np.asarray(np.nan_to_num(raw, nan=clock.LAST_US).clip(0, clock.LAST_US), np.int64)
    # what is below 0 becomes huge
    unsigned = raw.astype(np.uint64, copy=False)
    return np.asarray(np.minimum(unsigned, np.uint64(clock.LAST_US)).view(np.int64), np.int64)


def nanoseconds(raw: NDArray[Any]) -> TimeArray:
    """Time fields in microseconds as a new array in nanoseconds, cut as by `microseconds`."""
    time_ns = microseconds(raw)
    time_ns *= 1000
    return time_ns


_FEWEST_RECORDS = 10  # without a second between them, of sensors; parameters come one by one


def timeline(blocks: Iterable[Stamps]) -> Timeline:
    """Power-ups and stray stamps, from all times since boot of a log in its order.

    A step back by more than 1 s is a power-up, unless `stray_stretches` has it.

    >>> time_ns = np.array([5, 6, 7, 8, 9, 2, 3, 4, 5, 6]) * 10**9
    >>> timeline([(np.arange(10), time_ns)]).boot_of(np.array([4, 5]))
    array([0, 1], dtype=int16)
    """
    stretches: list[list[int]] = []  # the first place, the first and last time, how many records
    for places, time_ns in blocks:
        if not places.shape[0]:
            continue
        cuts = np.flatnonzero(np.abs(np.diff(time_ns)) > clock.BOOT_STEP_NS) + 1
        starts, stops = np.append(0, cuts), np.append(cuts, time_ns.shape[0])
        columns = (places[starts], time_ns[starts], time_ns[stops - 1], stops - starts)
        rows = np.stack(columns, axis=1).tolist()
        if stretches and abs(rows[0][1] - stretches[-1][2]) <= clock.BOOT_STEP_NS:  # goes on
            _, _, last, more = rows.pop(0)
            stretches[-1][2:] = [last, stretches[-1][3] + more]
        stretches += rows
    starts, begins, ends, counts = np.array(stretches, np.int64).reshape(-1, 4).T.copy()
    stray = clock.stray_stretches(begins, ends, counts)
    steady = ~stray
    back = begins[steady][1:] - ends[steady][:-1] < -clock.BOOT_STEP_NS
    number = np.append(0, np.cumsum(back)).astype(np.int16)
    boot = number[np.maximum(np.cumsum(steady) - 1, 0)] if starts.size else np.empty(0, "i2")
    return Timeline(starts, begins, ends, counts, stray, boot)


def report_timeline(line: Timeline, ledger: Ledger) -> None:
    """Enter stray stamps, and silences between sensors, of a log whose places are bytes."""
    if line.stray.any():
        count = int(line.length[line.stray].sum())
        what = f"{count} records carry a time that fits none of their neighbours"
        where = f"first at byte {int(line.first[line.stray][0])}"
        ledger.loss("TIME-STRAY", what, where=where, count=count)
    after, silence = line.silences()
    steady = np.flatnonzero(~line.stray & (line.length >= _FEWEST_RECORDS))
    inside = (after > steady[0]) & (after <= steady[-1]) if steady.size else after < 0
    after, silence = after[inside], silence[inside]
    if after.size:
        where, together = f"first before byte {int(line.first[after[0]])}", silence.sum() / 1e9
        ledger.warning("LOG-GAP", where=where, count=int(after.size), seconds=together)


@dataclass(frozen=True)
class UtcReadings:
    """UTC beside the time since boot, by one source, (n,) in the order of the log.

    ``usable`` False: no UTC, a stray stamp. ``fix`` of a receiver, empty for other sources.
    """

    source: str
    places: Integers
    boot_ns: TimeArray
    utc_ns: TimeArray
    usable: Mask
    fix: NDArray[Any] = field(default_factory=lambda: np.empty(0))

    def sound(self, line: Timeline) -> "UtcReadings":
        """The rows without stray stamps, with a fix, and with another UTC than the row before."""
        good = self.usable & line.good(self.places)
        if self.fix.size:
            good &= self.fix >= LOWEST_FIX
        good[good] = clock.new_readings(self.utc_ns if bool(good.all()) else self.utc_ns[good])
        if bool(good.all()):
            return self
        columns = (self.places, self.boot_ns, self.utc_ns)
        places, boot_ns, utc_ns = (column[good] for column in columns)
        return UtcReadings(self.source, places, boot_ns, utc_ns, good[good])


@dataclass(frozen=True)
class BootClock:
    """UTC of a clock that begins anew at each boot of ``line``.

    ``fits`` is None where no source gives UTC; ``utc_known`` False where only the recorder does.
    """

    line: Timeline
    fits: tuple[clock.ClockOffset | None, ...]
    utc_known: tuple[bool, ...]

    def utc(self, places: Integers, boot_ns: TimeArray) -> TimeArray:
        """UTC [ns] of times since boot at places of the log; these where UTC is unknown."""
        offsets = np.array([fit.offset_ns if fit else 0 for fit in self.fits], np.int64)
        utc_ns = offsets[self.line.boot_of(places)]
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
) -> BootClock:
    """One offset of UTC from the time since boot, for each boot; how well it fits is reported.

    ``sources``: in each boot the one with the most rows is used, by their median; another that
    differs by more than 1 s is a loss. ``cameras`` count where none of them has UTC, ``recorder``
    in boots without any; without UTC a boot counts as if in 1970. ``where``, ``utc_of``: the
    vehicle and what gives UTC in this format, for the ledger.

    A boot is also split where nothing was recorded for more than 1 s and the offset is another by
    more than 1 s from there on. Where it steps while the time runs on, a clock was set: no boot.
    """
    sources = [source.sound(line) for source in sources]
    if not any(source.places.size for source in sources):
        sources = [camera.sound(line) for camera in cameras]
    sources = sorted(sources, key=lambda source: -source.places.size)
    spare = [recorder.sound(line)] if recorder is not None else []
    known = line.boots
    at_silence = line.first[line.silences()[0]]
    # silences about which better sources decide: those with rows on both sides, in one boot
    decided = np.zeros(at_silence.shape, np.bool_)
    by_steps = line
    for source in [*sources, *spare]:
        line = _split_boots(line, source, decided)
        boots = np.concatenate([[-1], by_steps.boot_of(source.places), [-2]]).astype(np.int64)
        row = np.searchsorted(source.places, at_silence)
        decided |= boots[row] == boots[row + 1]
    if line.boots > known:
        ledger.warning("TIME-REBOOT", where=where, count=line.boots - known)
    fits, known_utc = [], []
    for number in range(line.boots):
        place = f"{where}, boot {number}".removeprefix(", ")
        by_source = [(source, _fit_boot(line, number, source)) for source in sources]
        fit = _best_fit(by_source, place, ledger)
        known_utc.append(fit is not None)
        if fit is None and spare:
            fit = _fit_boot(line, number, spare[0])
        if fit is None:
            ledger.fallback("TIME-NO-UTC", where=place, utc_of=utc_of)
        fits.append(fit)
    return BootClock(line, tuple(fits), tuple(known_utc))


def _split_boots(line: Timeline, source: UtcReadings, decided: Mask) -> Timeline:
    """Split boots where this source's offset steps at a silence that is not ``decided`` yet."""
    after, silence = line.silences()
    free = ~decided & (line.boot[after] == line.boot[after - 1])
    after, silence = after[free], silence[free]
    if not after.size or not source.places.shape[0]:
        return line
    at = line.first[after]
    boots = line.boot_of(source.places)
    boot = line.boot.copy()
    for number in np.unique(boots).tolist():
        rows = np.flatnonzero(boots == number)
        offset = without_glitches(source.utc_ns[rows] - source.boot_ns[rows])
        for row in np.flatnonzero(np.abs(np.diff(offset)) > clock.BOOT_STEP_NS).tolist():
            places = source.places[rows[row : row + 2]]
            between = slice(*np.searchsorted(at, places, side="right"))
            if silence[between].size:
                boot[after[between][np.argmax(silence[between])] :] += 1
    return replace(line, boot=boot)


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
    rows = line.boot_of(source.places) == number
    return clock.fit_offset(source.utc_ns[rows], source.boot_ns[rows])


def _best_fit(
    by_source: Sequence[tuple[UtcReadings, clock.ClockOffset | None]], place: str, ledger: Ledger
) -> clock.ClockOffset | None:
    """The offset of a boot by the source with the most rows; sources that differ are losses."""
    fits = [(source, fit) for source, fit in by_source if fit is not None]
    if not fits:
        return None
    chosen, best = max(fits, key=lambda pair: pair[1].rows)
    ledger.add(clock.clock_fit_note(f"{best.rows} {chosen.source}", best, place))
    for source, fit in fits:
        apart = fit.offset_ns - best.offset_ns
        if abs(apart) > clock.BOOT_STEP_NS:
            what = f"{fit.rows} {source.source} give a UTC {apart / 1e9:+.3f} s from that of"
            what += f" {best.rows} {chosen.source}, which are used"
            ledger.loss("TIME-SOURCES", what, where=place, count=fit.rows)
    return best
