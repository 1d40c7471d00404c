"""Events of a camera in the log, and what its images say themselves of their exposure.

`assignment` brings both together.
"""

from dataclasses import dataclass

import numpy as np

from unbend.block.alignment import Axis
from unbend.flight.exposures import unwrapped_numbers
from unbend.units import Array, Integers, Mask

WRONG_NAMES = -float(np.log(1e5))  # log probability of names that are not as their pattern says
COUNT_ROUND = 1 << 16  # numbers of the log's index count modulo this
WINDOW_SIGMAS = 6.0  # beyond which a time says no more than that it does not fit
BOUNCE_S = 0.2  # a pulse that bounced or was logged twice follows within this
BOUNCE = 0.25  # and within this share of the shorter intervals
SIGMA_OF_NUMBERS = 0.05  # numbers are whole


@dataclass(frozen=True, eq=False)
class CameraEvents:
    """Events of one camera in the order of their time.

    ``time_s`` (m,) of the log [s], from any origin; ``index`` (m,) the log's own numbers, which
    may count modulo 65536, or None.
    """

    time_s: Array
    index: Integers | None = None

    def __post_init__(self) -> None:
        is_known = np.all(np.isfinite(self.time_s))
        if not is_known or np.any(np.diff(self.time_s) < 0.0):
            raise ValueError("events are not in the order of their time")

    @property
    def pulse(self) -> Integers:
        """(m,) the number of the pulse that each event is of, from 1."""
        return np.cumsum(~self.repeated).astype(np.int64)

    @property
    def repeated(self) -> Mask:
        """(m,) events that repeat the one before: a pulse that bounced or was logged twice.

        They follow within 0.2 s and a quarter of the shorter intervals (lower quartile), or have
        the same index.
        """
        step = np.diff(self.time_s)
        intervals = step[step > 0.0]
        soon_s = BOUNCE_S
        if intervals.size:
            shorter_s = float(np.quantile(intervals, 0.25))
            soon_s = min(BOUNCE_S, BOUNCE * shorter_s)
        again = step < soon_s
        if self.index is not None:
            again |= np.diff(self.index) == 0
        repeated = np.zeros(self.time_s.size, np.bool_)
        repeated[1:] = again
        return repeated


@dataclass(frozen=True, eq=False)
class ImageEvidence:
    """What ``count`` images of one camera say of their exposure; anything may be None.

    Parameters
    ----------
    time_s : (k,) by the camera's clock [s], from any origin; NaN where an image has none.
    sigma_s : of these times [s], one or (k,): 12 ** -0.5 without sub-seconds.
    clock_offset_s, clock_sigma_s : what is known of event time minus camera time [s]; a clock of
        which nothing is known has an infinite sigma.
    drift_sigma : of the camera clock's rate (5e-5: 0.18 s in an hour).
    number : (k,) from the names.
    numbering : what the numbers are: ``index``, those of the log's index (modulo 65536);
        ``counted``, the events counted from 1; ``sequence``, the camera's own, which give the
        order and the gaps only.
    total : for ``counted``, how many images were exposed; by default the largest number.
    """

    count: int
    time_s: Array | None = None
    sigma_s: float | Array = 0.05
    clock_offset_s: float = 0.0
    clock_sigma_s: float = np.inf
    drift_sigma: float = 5e-5
    number: Integers | None = None
    numbering: str = "sequence"
    total: int | None = None

    def __post_init__(self) -> None:
        for values in (self.time_s, self.number):
            if values is not None and values.shape != (self.count,):
                raise ValueError(f"{values.shape} values for {self.count} images")
        if self.numbering not in ("index", "counted", "sequence"):
            raise ValueError(f"numbering {self.numbering!r}")

    def axis(self, events: CameraEvents) -> Axis:
        """Events and images in their order: by times where at least half of the images have one."""
        if self.time_s is not None:
            timed = np.count_nonzero(np.isfinite(self.time_s))
            if timed >= 0.5 * self.count:
                return self.axis_of_times(events, self.time_s)
        return self.axis_of_numbers(events)

    @property
    def number_or_row(self) -> Integers:
        """(k,) the numbers of the names, or the order in which images are given."""
        if self.number is None:
            return np.arange(self.count)
        return self.number

    def axis_of_times(self, events: CameraEvents, time_s: Array) -> Axis:
        """Events by the time of the log, images by that of their camera; without those of none."""
        timed = np.count_nonzero(np.isfinite(time_s))
        order = np.lexsort((self.number_or_row, time_s))
        order = order[:timed]  # NaN is last
        sigma_s = np.broadcast_to(self.sigma_s, time_s.shape)
        return Axis(
            events=events.time_s,
            images=time_s[order],
            sigma=sigma_s[order].astype(np.float64),
            pulse=events.pulse,
            image_rows=order,
            is_time=True,
            offset=self.clock_offset_s,
            offset_sigma=self.clock_sigma_s,
            drift_sigma=self.drift_sigma,
        )

    def axis_of_numbers(self, events: CameraEvents) -> Axis:
        """Events and images by their numbers."""
        event_number = self.numbers_of_events(events)
        number = self.number_or_row
        if self.numbering == "index" and event_number.size:
            middle = int(event_number[0] + event_number[-1]) // 2
            first = middle - COUNT_ROUND // 2
            number = first + (number - first) % COUNT_ROUND
        order = np.argsort(number, kind="stable")
        return Axis(
            events=event_number.astype(np.float64),
            images=number[order].astype(np.float64),
            sigma=np.full(self.count, SIGMA_OF_NUMBERS),
            pulse=events.pulse,
            image_rows=order,
            is_time=False,
        )

    def numbers_of_events(self, events: CameraEvents) -> Integers:
        """(m,) numbers of events that numbers of images may count.

        From 1 where images are ``counted``; else those of the log's index if it ascends, or those
        of the pulses, of which repeats count once.
        """
        if self.numbering == "counted":
            return np.arange(events.time_s.size) + 1
        if events.index is not None:
            index = unwrapped_numbers(events.index)
            if np.all(np.diff(index) >= 0):
                return index
        return events.pulse

    def names_speak(self, events: CameraEvents) -> bool:
        """Whether names say which event is whose: counted ones only where the counts are equal."""
        if self.number is None or self.count == 0:
            return False
        if self.numbering == "sequence":
            return False
        if self.numbering == "index":
            return events.index is not None
        total = self.total
        if total is None:
            total = int(self.number.max())
        return total == events.time_s.size

    def rows_of_names(self, events: CameraEvents) -> Integers:
        """(k,) the row of the event that each name claims, -1 for none and where names say none."""
        claimed = np.full(self.count, -1, np.int64)
        if self.number is None or not self.names_speak(events):
            return claimed
        number_of_row = np.arange(events.time_s.size) + 1
        if self.numbering == "index" and events.index is not None:
            number_of_row = events.index % COUNT_ROUND
        row_of_number = {}
        for row, number in enumerate(number_of_row.tolist()):
            row_of_number[number] = row
        for image, number in enumerate(self.number.tolist()):
            claimed[image] = row_of_number.get(number % COUNT_ROUND, -1)
        return claimed

    def offsets_of_names(self, events: CameraEvents, axis: Axis) -> Array:
        """(1,) the offset under which names are what their pattern says; (0,) where they are mute.

        It is a hypothesis even where many others bring as many images to an event.
        """
        claimed = self.rows_of_names(events)[axis.image_rows]
        has_claim = claimed >= 0
        if not has_claim.any():
            return np.empty(0)
        apart = axis.events[claimed[has_claim]] - axis.images[has_claim]
        return np.array([np.median(apart)])

    def log_likelihood_of_times(
        self, events: CameraEvents, rows: Integers, sigma_s: float
    ) -> float:
        """Log likelihood of the camera's times alone, if images (k,) are of the events ``rows``.

        At the likeliest offset and drift of the camera's clock; 0 without times. A time that is six
        sigmas off costs no more than one that is farther. ``sigma_s`` is the least sigma.
        """
        if self.time_s is None:
            return 0.0
        has_both = (rows >= 0) & np.isfinite(self.time_s)
        timed = np.flatnonzero(has_both)
        if timed.size == 0:
            return 0.0
        camera_s = self.time_s[timed]
        sigma = np.broadcast_to(self.sigma_s, self.time_s.shape)
        sigma = np.maximum(sigma[timed], sigma_s)
        apart_s = events.time_s[rows[timed]] - camera_s
        offset_s = float(np.median(apart_s))
        misfit = misfits_of_drift(
            camera_s,
            late_s=apart_s - offset_s,
            sigma=sigma,
            drift_sigma=self.drift_sigma,
        )
        misfit_of_clock = (offset_s - self.clock_offset_s) / self.clock_sigma_s
        cost = np.minimum(misfit**2, WINDOW_SIGMAS**2)
        total = cost.sum() + misfit_of_clock**2
        return -0.5 * float(total)

    def log_prior_of_names(self, events: CameraEvents, rows: Integers) -> Array:
        """(c,) log probability of assignments (c, k) by what the pattern of the names claims."""
        if not self.names_speak(events) or self.number is None:
            return np.zeros(rows.shape[0])
        agrees = rows + 1 == self.number
        if self.numbering == "index" and events.index is not None:
            agrees = (events.index[rows] - self.number) % COUNT_ROUND == 0
        has_event = rows >= 0
        agreeing = np.sum(agrees & has_event, axis=1)
        assigned = np.sum(has_event, axis=1)
        most_agree = agreeing > 0.5 * assigned
        return np.where(most_agree, 0.0, WRONG_NAMES)


def misfits_of_drift(
    camera_s: Array,
    late_s: Array,
    sigma: Array,
    drift_sigma: float,
) -> Array:
    """(k,) what remains in sigmas of how late events are, with the likeliest drift of the camera.

    Times that are six sigmas off say nothing of the drift.
    """
    near = np.abs(late_s) < WINDOW_SIGMAS * sigma
    since_middle = (camera_s - np.median(camera_s)) / sigma
    right = since_middle * late_s / sigma
    normal = np.sum(since_middle[near] ** 2) + drift_sigma**-2.0
    drift = np.sum(right[near]) / normal
    drifted = drift * since_middle
    return np.asarray(late_s / sigma - drifted)
