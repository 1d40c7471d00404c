"""The clocks of a telemetry log: each sender's boots, and its time in UTC.

Messages carry time since boot; SYSTEM_TIME ties that to UTC. The log's stamps are of the ground
station, seconds off UTC and irregular by the radio link: they place messages without a time among
those with one. Cameras and gimbals have no SYSTEM_TIME: whether they count by the autopilot's clock
or their own, the reception of their messages shows.
"""

from collections.abc import Callable, Container, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from unbend.flight.channels import TimeArray
from unbend.flight.clock import BOOT_STEP_NS, clock_map, stray_times
from unbend.ingest.boot_clock import BootClock, UtcReadings, fit_clock, timeline
from unbend.ingest.tlog.clock_samples import MICROSECOND, MILLISECOND, Key, Readings
from unbend.messages import Ledger
from unbend.units import NANOSECONDS_PER_SECOND, Integers, Mask, Rows

ROUND_MS = (1 << 32) * MILLISECOND  # 49.7 days: a 32-bit count of milliseconds runs over


ROUND_US = (1 << 32) * MICROSECOND  # 71.6 minutes: one of microseconds


# Fields with a time since boot: their unit [ns], and the time [ns] after which they wrap.
CLOCK_FIELDS = {"time_boot_ms": (MILLISECOND, ROUND_MS), "time_usec": (MICROSECOND, ROUND_US)}


# Largest difference of a stamp that wrapped from the sender's clock: exposures are reported up to
# some seconds late, and a minute is a seventieth of the shorter period.
NEAR_NS = 60 * NANOSECONDS_PER_SECOND


# Delay of a message that is stamped on arrival: links and cameras delay by up to some seconds, the
# link's jitter is 2 s at most in real logs.
EARLIEST_NS, LATEST_NS = -2 * NANOSECONDS_PER_SECOND, 10 * NANOSECONDS_PER_SECOND


@dataclass(frozen=True)
class SenderClock:
    """One sender's clock and its boots in UTC.

    ``at``, ``boot_ns`` (n,): readings each second and at each boot, empty where none is known. By
    boot: ``counts`` of readings, ``maps`` from the ground station's clock to UTC.
    """

    at: Integers
    boot_ns: TimeArray
    clock: BootClock
    counts: tuple[int, ...]
    maps: tuple[Callable[[TimeArray], TimeArray], ...]

    def boot(self, at: Integers) -> NDArray[np.int16]:
        """The boot of messages at these places of the file."""
        return self.clock.line.boot_of(at)

    def _row(self, at: Integers) -> Rows:
        """The reading that stands before each place of the file, or the first."""
        return np.maximum(np.searchsorted(self.at, at, side="right") - 1, 0)

    def boot_places(self, at: Integers, boot_ns: TimeArray) -> Integers:
        """Places of that boot: messages may come before the first reading of its clock."""
        if self.clock.line.boots == 1:
            return at
        row = self._row(at)
        after = np.minimum(row + 1, self.at.shape[0] - 1)
        closer = np.abs(boot_ns - self.boot_ns[after]) < np.abs(boot_ns - self.boot_ns[row])
        closer &= self.boot(self.at[after]) != self.boot(at)
        return np.asarray(np.where(closer, self.at[after], at), np.int64)

    def utc_of_host(self, at: Integers, host_ns: TimeArray) -> TimeArray:
        """UTC [ns] of messages without a time of their own."""
        if not self.at.size:
            return host_ns
        boot, result = self.boot(at), host_ns.copy()
        for number in np.unique(boot):
            asked = boot == number
            result[asked] = self.maps[int(number)](host_ns[asked])
        return result

    def utc_of_boot(
        self, at: Integers, host_ns: TimeArray, boot_ns: TimeArray, turn: int
    ) -> TimeArray:
        """UTC [ns] of times since boot that wrap after ``turn`` [ns]; the log's without a clock."""
        if not self.at.size:
            return host_ns
        near = np.asarray(self.boot_ns[self._row(at)], np.int64)
        return self.clock.utc(at, unrolled(boot_ns, near, turn))


_HOST_CLOCK = SenderClock(
    np.empty(0, np.int64), np.empty(0, np.int64), BootClock(timeline([]), (None,), (False,)), (0,),
    (lambda host_ns: host_ns,),
)  # fmt: skip


@dataclass(frozen=True)
class Clocks:
    """All senders of a log, the vehicle's ``boots``; ``wrong_utc``: of images of these senders."""

    senders: Mapping[Key, SenderClock]
    boots: int
    description: str
    wrong_utc: frozenset[Key] = frozenset()

    def lender(self, source: Key) -> Key | None:
        """The sender whose clock is used: this one, else another component of its system."""
        if source in self.senders:
            return source
        same = [key for key in self.senders if key[0] == source[0]]
        return max(same, key=lambda key: sum(self.senders[key].counts), default=None)

    def of(self, source: Key) -> SenderClock:
        """The clock of a sender; where none is known, that of the ground station."""
        lender = self.lender(source)
        return _HOST_CLOCK if lender is None else self.senders[lender]

    def advanced(self, source: Key, at: int, least_ns: int) -> bool:
        """Whether a sender's clock, if known, advances by so much at a place, within a boot."""
        sender = self.senders.get(source, _HOST_CLOCK)
        row = int(np.searchsorted(sender.at, at))
        if not 0 < row < sender.at.shape[0]:
            return True
        boots = sender.boot(sender.at[row - 1 : row + 1])
        step = int(sender.boot_ns[row] - sender.boot_ns[row - 1])
        return bool(boots[0] == boots[1]) and step >= least_ns


def clock_field(names: Container[str]) -> str:
    """The field of a message that has its time, or ""."""
    return next((name for name in CLOCK_FIELDS if name in names), "")


def unrolled(stamp_ns: TimeArray, near_ns: TimeArray, turn: int) -> TimeArray:
    """(n,) stamps [ns] of a counter that wraps after ``turn``, completed where near the clock.

    >>> unrolled(np.array([5 * 10**9]), np.array([ROUND_US + 4 * 10**9]), ROUND_US) - ROUND_US
    array([5000000000])
    """
    behind = near_ns - stamp_ns
    if not behind.shape[0] or int(behind.max()) <= turn // 2:
        return stamp_ns
    turns = np.rint(behind / turn).astype(np.int64)
    whole = stamp_ns + turns * turn
    fits = (turns > 0) & (np.abs(whole - near_ns) < NEAR_NS)
    return np.asarray(np.where(fits, whole, stamp_ns), np.int64)


def clocks_of(readings: Readings, ledger: Ledger) -> Clocks:
    """Fit the clocks of all senders; residuals and fallbacks are entered in the ledger."""
    if not readings.size:
        ledger.fallback("TIME-HOST-CLOCK/clocks-of")
        return Clocks({}, 1, "ground station clock")
    unique, counts = np.unique(readings["source"], return_counts=True)
    busiest = [divmod(key, 256) for key in unique[np.argsort(-counts, kind="stable")].tolist()]
    vehicle = busiest[0]
    senders: dict[Key, SenderClock] = {}
    for source in busiest:
        of_source = _some(readings, readings["source"] == source[0] * 256 + source[1])
        leader = senders.get(vehicle, _HOST_CLOCK) if vehicle[0] == source[0] else _HOST_CLOCK
        senders[source] = _fit_sender(of_source, leader, source, ledger)
    clock = senders[vehicle].clock
    known, boots = clock.utc_known.count(True), len(clock.utc_known)
    description = f"vehicle clock, set to UTC by SYSTEM_TIME in {known} of {boots} boots"
    if known == boots:
        description = "vehicle clock, set to UTC by the median of SYSTEM_TIME"
    elif known == 0:
        description = "vehicle clock, set by the ground station's clock"
    return Clocks(senders, clock.line.boots, description)


def _some(readings: Readings, rows: Mask) -> Readings:
    """Some of the readings, not copied where these are all: memory has its peak here."""
    return readings if bool(rows.all()) else readings[rows]


def overtaken(readings: Readings) -> Mask:
    """Which (n,) readings of a sender are of messages that others overtook, without a restart.

    They are up to `LATEST_NS` older than one before them, received when the sender was on as long.
    """
    boot_ns, host_ns = readings["boot_ns"], readings["host_us"] * MICROSECOND
    newest = np.maximum.accumulate(boot_ns)
    row = np.maximum.accumulate(np.where(newest == boot_ns, np.arange(newest.size), 0))
    late = newest - boot_ns
    on_before = host_ns - boot_ns < host_ns[row] - LATEST_NS
    return np.asarray((late > BOOT_STEP_NS) & (late < LATEST_NS) & on_before, np.bool_)


def _fit_sender(readings: Readings, lead: SenderClock, source: Key, ledger: Ledger) -> SenderClock:
    """A sender's clock; without UTC of its own it is set by when its messages were received."""
    where = f"system {source[0]}, component {source[1]}"
    readings = _some(readings, ~stray_times(readings["boot_ns"]))  # a glitch of it is no boot
    if bool(np.any(np.diff(readings["boot_ns"]) < -BOOT_STEP_NS)):
        readings = _some(readings, ~overtaken(readings))
    at, boot_ns, sent_utc = readings["at"], readings["boot_ns"], readings["utc_ns"]
    stamped_ns = readings["host_us"] * MICROSECOND
    step = np.diff(boot_ns)
    # A new boot starts near zero too, but not exactly when the count was full by the host's clock.
    # A message that was overtaken has the time before the wrap: a step by a turn the other way.
    turn = np.rint(-step / ROUND_MS).astype(np.int64)
    turn[np.abs(step + turn * ROUND_MS - np.diff(stamped_ns)) > NEAR_NS] = 0
    if turn.any():
        turns = np.concatenate([[0], np.cumsum(turn)])
        boot_ns = np.asarray(boot_ns + turns * ROUND_MS, np.int64)
        ledger.note("TIME-WRAP", where=where, count=int(turns.max()))
    host_ns = lead.utc_of_host(at, stamped_ns)
    system_time = UtcReadings("SYSTEM_TIME messages", at, boot_ns, sent_utc, sent_utc > 0)
    received = UtcReadings("stamps", at, boot_ns, host_ns, np.ones(at.shape, np.bool_))
    clock = fit_clock(timeline([(at, boot_ns)]), [system_time], ledger, received, where)
    boot = clock.line.boot_of(at)
    counts = np.bincount(boot, minlength=clock.line.boots).tolist()
    maps = []
    for number, (count, fit) in enumerate(zip(counts, clock.fits, strict=True)):
        rows = slice(sum(counts[:number]), sum(counts[:number]) + count)
        maps.append(clock_map(stamped_ns[rows], clock.utc(at[rows], boot_ns[rows])))
        if fit is not None and not clock.utc_known[number]:
            place, spread_ms = f"{where}, boot {number}", fit.spread_ns / 1e6
            ledger.fallback("TIME-HOST-CLOCK/stamps", where=place, count=count, spread_ms=spread_ms)
    mark = np.ones(boot.shape, np.bool_)
    mark[1:] = (np.diff(boot_ns // NANOSECONDS_PER_SECOND) != 0) | (np.diff(boot) != 0)
    return SenderClock(at[mark], boot_ns[mark], clock, tuple(counts), tuple(maps))
