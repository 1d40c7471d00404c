"""UTC minus the time since boot of each boot, for all log formats: few records carry UTC."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from unbend.flight import clock
from unbend.flight.channels import TimeArray
from unbend.ingest import messages
from unbend.ingest.limits import check_boots
from unbend.ingest.timelines import Silences, Timeline, place_of_boot
from unbend.ingest.utc_evidence import ClockAssessment, Witness, date_text
from unbend.ingest.utc_readings import DateCheck, UtcReadings, possible_recorder
from unbend.messages import Ledger
from unbend.units import NANOSECONDS_PER_SECOND, Integers, Mask

RECORDER_APART_S = 60.0  # a recorder set by a network is seconds off, one set by hand may be hours
_BLOCK = 65_536  # rows of the running median at once


@dataclass(frozen=True)
class BootClock:
    """The conversion from times since boot to UTC, for each boot of ``line``.

    fits : for each boot the offset of UTC from the time since boot; None if nothing gives UTC.
    utc_known : for each boot False if nothing but the recorder, or nothing at all, gives UTC.
    sigma_s : [s] of UTC in the worst boot; NaN if no boot has UTC.
    assessments : how good each clock of the log is, and if it is used.
    """

    line: Timeline
    fits: tuple[clock.ClockOffset | None, ...]
    utc_known: tuple[bool, ...]
    sigma_s: float = float("nan")
    assessments: tuple[ClockAssessment, ...] = ()

    def utc(self, places: Integers, boot_ns: TimeArray) -> TimeArray:
        """Convert (n,) times since boot [ns] to UTC [Unix ns].

        ``places``: (n,) places of the records in the log, which decide the boot. Times in a boot
        without UTC are returned unchanged.
        """
        offset_of_boot_ns = [fit.offset_ns if fit else 0 for fit in self.fits]
        offsets_ns = np.array(offset_of_boot_ns, np.int64)
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
    fallbacks: Sequence[UtcReadings] = (),
    utc_of: str = "source of UTC",
    witnesses: Sequence[Witness] = (),
) -> BootClock:
    """Fit the offset of UTC from the time since boot, for each boot, and report how well it fits.

    What gives UTC in a boot:

    - Among the ``sources``, the source with the most rows in that boot; the offset is the median
      over its rows. Each other source that differs by more than 1 s is reported as a loss.
    - ``fallbacks`` (for example cameras) in place of the sources, if no source has UTC in any boot.
    - ``recorder``, in a boot without any of these.
    - Else nothing: the times of the boot count from 1970.

    Impossible dates are repaired or not used; ``witnesses`` are further clocks that know the date.
    In the reports ``where`` is the name of the vehicle, and ``utc_of`` names the rows that give UTC
    in this format.

    A boot is also split where nothing was recorded for more than 1 s and the offset after this
    silence differs by more than 1 s: the vehicle was restarted. A step of the offset without a
    silence does not split: there a clock was set.
    """
    if recorder is not None:
        recorder = possible_recorder(recorder.usable_rows(line), line, where, ledger)
    dates = DateCheck(line, recorder, tuple(witnesses), where)
    accepted = [dates.acceptable(source.usable_rows(line), ledger) for source in sources]
    if not any(source.places.size for source in accepted):
        accepted = [dates.acceptable(source.usable_rows(line), ledger) for source in fallbacks]
    # The source with the most rows decides first about silences; in each boot `_utc_of_boots`
    # compares the sources again.
    accepted.sort(key=lambda source: -source.places.size)
    with_recorder = accepted if recorder is None else [*accepted, recorder]
    split_line = _split_at_silences(line, with_recorder)
    if split_line.boots > line.boots:
        ledger.add(messages.restarted(where=where, count=split_line.boots - line.boots))
    chosen = _utc_of_boots(split_line, accepted, recorder, where, ledger)
    for number, utc in enumerate(chosen):
        if utc.fit is None:
            place = place_of_boot(where, number)
            ledger.add(messages.no_utc(where=place, utc_of=utc_of))
    return _clock_of(split_line, chosen)


def _clock_of(line: Timeline, chosen: "Sequence[BootUtc]") -> BootClock:
    """The clock of a log from the UTC of each of its boots."""
    sigma_s = float("nan")  # until a boot has UTC: fmax ignores NaN
    assessments: list[ClockAssessment] = []
    for utc in chosen:
        assessments += utc.assessments
        if utc.fit is not None:
            sigma_s = float(np.fmax(sigma_s, utc.sigma_s))
    return BootClock(
        line,
        tuple(utc.fit for utc in chosen),
        tuple(utc.is_known for utc in chosen),
        sigma_s=sigma_s,
        assessments=tuple(assessments),
    )


def _split_at_silences(line: Timeline, sources: Sequence[UtcReadings]) -> Timeline:
    """Split boots at silences where the offset of a source steps.

    The first of the ``sources`` that has rows of one boot on both sides of a silence decides if the
    boot is split there.
    """
    silence_places = line.first[line.silences().after]
    is_decided = np.zeros(silence_places.shape, np.bool_)
    split_line = line
    for source in sources:
        split_line = _split_boots(split_line, source, is_decided)
        # `line`, not `split_line`: where a boot was split, the two sides are of different boots
        is_decided |= _has_both_sides(source, line, silence_places)
    return split_line


def _has_both_sides(source: UtcReadings, line: Timeline, silence_places: Integers) -> Mask:
    """(n,) whether the rows of a source next to a silence, before and behind, are of one boot.

    ``silence_places``: (n,) places in the log at which the silences end.
    """
    boots = line.boot_of(source.places)
    # -1 means no row before a silence, -2 none behind it: the two are never equal
    padded_boots = np.concatenate([[-1], boots, [-2]]).astype(np.int64)
    rows_behind = np.searchsorted(source.places, silence_places)
    boots_before = padded_boots[rows_behind]  # index 0 is the padding: row i is at index i + 1
    boots_behind = padded_boots[rows_behind + 1]
    return np.asarray(boots_before == boots_behind)


def _split_boots(line: Timeline, source: UtcReadings, is_decided: Mask) -> Timeline:
    """Split boots where the offset of a source steps at a silence that is not decided yet.

    ``is_decided``: (n,) for each of `line.silences()`, True if an earlier source has decided.
    """
    silences = line.silences()
    is_within_boot = line.boot[silences.after] == line.boot[silences.after - 1]
    may_split = ~is_decided & is_within_boot
    undecided = Silences(silences.after[may_split], silences.length_ns[may_split])
    if not undecided.after.size or not source.places.shape[0]:
        return line
    silence_places = line.first[undecided.after]
    boot = line.boot.copy()
    steps = _offset_steps(line, source)
    records = int(line.length.sum())
    check_boots(line.boots + len(steps), records)
    for before, after in steps:
        # the vehicle was restarted in the longest silence between the two rows
        begin, end = np.searchsorted(silence_places, [before, after], side="right")
        if begin < end:
            longest = begin + np.argmax(undecided.length_ns[begin:end])
            boot[undecided.after[longest] :] += 1  # the numbers of all later boots rise by one
    return replace(line, boot=boot)


def _offset_steps(line: Timeline, source: UtcReadings) -> list[tuple[int, int]]:
    """The places of the rows before and after each step of a source's offset within a boot."""
    boot = line.boot_of(source.places)
    steps: list[tuple[int, int]] = []
    for number in np.unique(boot).tolist():
        rows = np.flatnonzero(boot == number)
        places = source.places[rows]
        offset_ns = without_glitches(source.utc_ns[rows] - source.boot_ns[rows])
        is_step = np.abs(np.diff(offset_ns)) > clock.BOOT_STEP_NS
        places_before = places[:-1][is_step].tolist()
        places_after = places[1:][is_step].tolist()
        steps += zip(places_before, places_after, strict=True)
    return steps


def without_glitches(offset_ns: TimeArray) -> TimeArray:
    """The running median of offsets: steps remain, glitches of up to `STRAY_ROWS` rows do not.

    A single offset, or none, is returned as it is.
    """
    half_window = min(clock.STRAY_ROWS, offset_ns.shape[0] - 1)
    if half_window < 1:
        return offset_ns
    padded = np.pad(offset_ns, half_window, mode="reflect")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * half_window + 1)
    steady = np.empty_like(offset_ns)
    for begin in range(0, offset_ns.shape[0], _BLOCK):  # all at once would be the peak of memory
        block = slice(begin, begin + _BLOCK)
        steady[block] = np.partition(windows[block], half_window, axis=1)[:, half_window]
    return steady


def _fit_boot(line: Timeline, number: int, source: UtcReadings) -> clock.ClockOffset | None:
    """The offset of a boot by one source; None where the source has no rows in that boot."""
    rows = line.boot_of(source.places) == number
    return clock.fit_offset(source.utc_ns[rows], source.boot_ns[rows])


def _utc_of_boots(
    line: Timeline,
    sources: Sequence[UtcReadings],
    recorder: UtcReadings | None,
    where: str,
    ledger: Ledger,
) -> "list[BootUtc]":
    """Choose the source of UTC of each boot; report how well it fits and which sources differ."""
    recorders = [] if recorder is None else [recorder]
    chosen = []
    for number in range(line.boots):
        fitted = _BootSources(
            stated=_fitted(line, number, sources),
            recorded=_fitted(line, number, recorders),
            place=place_of_boot(where, number),
        )
        chosen.append(fitted.utc(ledger))
    return chosen


class BootUtc(NamedTuple):
    """UTC of a boot, and how good each clock with rows in this boot is.

    ``fit``: the offset of UTC, None without UTC. ``is_known``: False if UTC is that of the recorder
    or unknown. ``sigma_s``: of UTC [s], NaN without UTC.
    """

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
        """The sigma of its UTC [s]: of its clock, combined with the scatter of its rows."""
        return float(np.hypot(self.readings.sigma_s, self.fit.sigma_ns / 1e9))

    def seconds_from(self, other: "_FittedSource") -> float:
        """Its UTC minus that of another source [s]."""
        return (self.fit.offset_ns - other.fit.offset_ns) / 1e9

    def words(self) -> str:
        """The number of its rows in the boot and its name, for a report."""
        return self.readings.counted(self.fit.rows)


@dataclass(frozen=True)
class _BootSources:
    """The clocks that have rows in one boot.

    stated : the sources of UTC; may be empty.
    recorded : the recorder; empty if it has no rows in the boot.
    place : the vehicle and the boot in words.
    """

    stated: list[_FittedSource]
    recorded: list[_FittedSource]
    place: str

    def utc(self, ledger: Ledger) -> BootUtc:
        """UTC of the boot by the source with the most rows, else by the recorder, else unknown."""
        if self.stated:
            used = max(self.stated, key=lambda source: source.fit.rows)
            ledger.add(clock.clock_fit_note(used.words(), used.fit, self.place))
            self._report_contradictions(used, ledger)
            return self._utc_by(used, is_known=True, sigma_s=self._sigma_s(used))
        if self.recorded:
            used = self.recorded[0]
            return self._utc_by(used, is_known=False, sigma_s=self._sigma_s(used))
        return _without_utc(self.place)

    def _utc_by(self, used: _FittedSource, *, is_known: bool, sigma_s: float) -> BootUtc:
        """UTC by the ``used`` source, with the assessments of all clocks of the boot."""
        assessments = []
        for source in (*self.stated, *self.recorded):
            assessments.append(_assessment(source, used, sigma_s, self.place))
        return BootUtc(
            used.fit,
            is_known=is_known,
            sigma_s=sigma_s,
            assessments=tuple(assessments),
        )

    def _sigma_s(self, used: _FittedSource) -> float:
        """The sigma of the UTC of the ``used`` source [s].

        For a clock that no receiver sets, sigma is at least its difference from the recorder, and
        the spread of its rows: if it was set during the flight, no row shows whether it was right
        before or after.
        """
        if used.readings.is_set_by_receiver:
            return used.sigma_s
        spread_s = used.fit.spread_ns / NANOSECONDS_PER_SECOND
        sigma_s = max(used.sigma_s, spread_s)
        for recorder in self.recorded:
            sigma_s = max(sigma_s, abs(recorder.seconds_from(used)))
        return sigma_s

    def _report_contradictions(self, used: _FittedSource, ledger: Ledger) -> None:
        """Report sources more than 1 s from the ``used`` source, and a recorder more than 60 s."""
        for source in self.stated:
            apart_s = source.seconds_from(used)
            if abs(apart_s) * 1e9 > clock.BOOT_STEP_NS:
                ledger.add(
                    messages.sources_disagree(
                        where=self.place,
                        rows=source.fit.rows,
                        source=source.words(),
                        apart_s=apart_s,
                        used=used.words(),
                    )
                )
        for recorder in self.recorded:
            apart_s = recorder.seconds_from(used)
            if abs(apart_s) > RECORDER_APART_S:
                ledger.add(
                    messages.recorder_disagrees(
                        where=self.place,
                        recorder=recorder.readings.source,
                        apart_s=apart_s,
                        used=used.words(),
                    )
                )


def _without_utc(place: str) -> BootUtc:
    """The result for a boot in which no clock of the log gives UTC."""
    assessment = ClockAssessment(
        clock=f"the vehicle's time ({place})",
        use="counts from boot",
        utc=None,
        apart_s=None,
        sigma_s=None,
        why="no clock of the log gives its UTC",
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
    source: _FittedSource, used: _FittedSource, sigma_of_used_s: float, place: str
) -> ClockAssessment:
    """The assessment of one source of UTC in a boot that takes its UTC from the ``used`` source."""
    is_used = source is used
    return ClockAssessment(
        clock=f"{source.words()} ({place})",
        use="UTC of the log" if is_used else "compared",
        utc=date_text(source.readings.utc_ns[0]) if source.readings.utc_ns.size else None,
        apart_s=source.seconds_from(used),
        sigma_s=sigma_of_used_s if is_used else source.sigma_s,
        why=source.readings.why,
    )
