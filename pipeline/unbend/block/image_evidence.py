"""Events of a camera in the log, and what times, numbers and names of its images tell about them.

`assignment` brings both together.
"""

from dataclasses import dataclass

import numpy as np

from unbend.block.alignment import Axis
from unbend.flight.exposures import unwrapped_numbers
from unbend.units import Array, Integers, Mask

WRONG_NAMES = -float(np.log(1e5))  # log probability that most names contradict their pattern
COUNT_ROUND = 1 << 16  # numbers of the log's index count modulo this
WINDOW_SIGMAS = 6.0  # a larger misfit of a time costs no more than this one
BOUNCE_S = 0.2  # a pulse that bounced or was logged twice follows within this time ...
BOUNCE = 0.25  # ... and within this share of the lower quartile of the intervals
SIGMA_OF_NUMBERS = 0.05  # numbers are whole


@dataclass(frozen=True, eq=False)
class CameraEvents:
    """Events of one camera in the order of their time.

    ``time_s`` (m,) are times of the log [s], from any origin. ``index`` (m,) are the numbers of the
    events in the log, which may count modulo 65536; None if the log has none.
    """

    time_s: Array
    index: Integers | None = None

    def __post_init__(self) -> None:
        is_known = np.all(np.isfinite(self.time_s))
        if not is_known or np.any(np.diff(self.time_s) < 0.0):
            raise ValueError("events are not in the order of their time")

    @property
    def pulse(self) -> Integers:
        """(m,) number of the pulse of each event, from 1; a repeat has that of its pulse."""
        return np.cumsum(~self.repeated).astype(np.int64)

    @property
    def repeated(self) -> Mask:
        """(m,) whether an event repeats the one before: a pulse that bounced or was logged twice.

        Repeats follow within `BOUNCE_S`, and within `BOUNCE` of the lower quartile of the
        intervals; or they have the same index.
        """
        step_s = np.diff(self.time_s)
        intervals_s = step_s[step_s > 0.0]
        longest_bounce_s = BOUNCE_S
        if intervals_s.size:
            quartile_s = float(np.quantile(intervals_s, 0.25))
            longest_bounce_s = min(BOUNCE_S, BOUNCE * quartile_s)
        repeats_previous = step_s < longest_bounce_s
        if self.index is not None:
            repeats_previous |= np.diff(self.index) == 0
        repeated = np.zeros(self.time_s.size, np.bool_)
        repeated[1:] = repeats_previous
        return repeated


@dataclass(frozen=True, eq=False)
class ImageEvidence:
    """What is known from ``count`` images of one camera about their exposure.

    Parameters
    ----------
    time_s : (k,) times of the camera's clock [s], from any origin; NaN for an image without one,
        None if no image has one.
    sigma_s : their standard deviation [s], one or (k,): 12 ** -0.5 for whole seconds.
    clock_offset_s, clock_sigma_s : known event time minus camera time [s] and its standard
        deviation, infinite for an unknown clock.
    drift_sigma : standard deviation of the camera clock's rate (5e-5: 0.18 s in an hour).
    number : (k,) numbers in the names; None for names without.
    numbering : what the numbers are: ``index``, those of the log's index (modulo 65536);
        ``counted``, the events counted from 1; ``sequence``, numbers of the camera, which only
        give the order and the gaps.
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
        """Events and images on one axis: of times if at least half of the images have one.

        Otherwise of numbers.
        """
        if self.time_s is not None:
            timed = np.count_nonzero(np.isfinite(self.time_s))
            if timed >= 0.5 * self.count:
                return self.axis_of_times(events, self.time_s)
        return self.axis_of_numbers(events)

    @property
    def number_or_row(self) -> Integers:
        """(k,) the numbers in the names; without numbers the rows of the images."""
        if self.number is None:
            return np.arange(self.count)
        return self.number

    def axis_of_times(self, events: CameraEvents, time_s: Array) -> Axis:
        """Events by the time of the log, images by that of their camera.

        ``time_s`` (k,); images without a time (NaN) are not on the axis.
        """
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
        """Events and images by their numbers (`numbers_of_events`, `number_or_row`).

        Numbers of the log's index, which are known modulo 65536, get the round that brings them
        nearest to the middle of the events.
        """
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
        """(m,) numbers of the events, to compare with those of the images.

        If images are ``counted``, events count from 1. Otherwise they have the log's index, if it
        does not descend, or else the number of their pulse.
        """
        if self.numbering == "counted":
            return np.arange(events.time_s.size) + 1
        if events.index is not None:
            index = unwrapped_numbers(events.index)
            if np.all(np.diff(index) >= 0):
                return index
        return events.pulse

    def names_state_events(self, events: CameraEvents) -> bool:
        """Whether the name of each image states its event.

        ``counted`` names do so only if as many images as events were exposed.
        """
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

    def events_of_names(self, events: CameraEvents) -> Integers:
        """(k,) row of the event that the name of each image states, -1 for none."""
        stated_rows = np.full(self.count, -1, np.int64)
        if self.number is None or not self.names_state_events(events):
            return stated_rows
        number_of_row = np.arange(events.time_s.size) + 1
        number_of_image = self.number
        if self.numbering == "index" and events.index is not None:
            number_of_row = events.index % COUNT_ROUND
            number_of_image = self.number % COUNT_ROUND
        row_of_number = {}
        for row, number in enumerate(number_of_row.tolist()):
            row_of_number[number] = row
        for image, number in enumerate(number_of_image.tolist()):
            stated_rows[image] = row_of_number.get(number, -1)
        return stated_rows

    def offsets_of_names(self, events: CameraEvents, axis: Axis) -> Array:
        """(1,) offset on an axis under which images have the events that their names state.

        (0,) if names state none. This offset is one of the hypotheses, also if many others pair as
        many images with events.
        """
        stated_rows = self.events_of_names(events)[axis.image_rows]
        states_event = stated_rows >= 0
        if not states_event.any():
            return np.empty(0)
        offsets = axis.events[stated_rows[states_event]] - axis.images[states_event]
        return np.array([np.median(offsets)])

    def log_likelihood_of_times(
        self, events: CameraEvents, rows: Integers, sigma_s: float
    ) -> float:
        """Log likelihood of the camera's times alone, if images have the events ``rows`` (k,).

        Computed at the likeliest offset and drift of the camera's clock; 0 without times. ``rows``
        are -1 for no event. Sigmas are at least ``sigma_s``; a misfit counts as six sigmas at most.
        """
        if self.time_s is None:
            return 0.0
        has_both = (rows >= 0) & np.isfinite(self.time_s)
        images = np.flatnonzero(has_both)
        if images.size == 0:
            return 0.0
        camera_s = self.time_s[images]
        all_sigmas_s = np.broadcast_to(self.sigma_s, self.time_s.shape)
        image_sigma_s = np.maximum(all_sigmas_s[images], sigma_s)
        apart_s = events.time_s[rows[images]] - camera_s
        offset_s = float(np.median(apart_s))
        misfit = misfits_without_drift(
            camera_s,
            late_s=apart_s - offset_s,
            sigma_s=image_sigma_s,
            drift_sigma=self.drift_sigma,
        )
        misfit_of_clock = (offset_s - self.clock_offset_s) / self.clock_sigma_s
        cost = np.minimum(misfit**2, WINDOW_SIGMAS**2)
        total = cost.sum() + misfit_of_clock**2
        return -0.5 * float(total)

    def log_prior_of_names(self, events: CameraEvents, rows: Integers) -> Array:
        """(c,) log probability of assignments (c, k) by the events that names state.

        0 if more than half of the images have the stated event, or if names state none; otherwise
        `WRONG_NAMES`. ``rows`` are rows of events, -1 for none.
        """
        if not self.names_state_events(events) or self.number is None:
            return np.zeros(rows.shape[0])
        agrees = rows + 1 == self.number
        if self.numbering == "index" and events.index is not None:
            agrees = (events.index[rows] - self.number) % COUNT_ROUND == 0
        has_event = rows >= 0
        agreeing = np.sum(agrees & has_event, axis=1)
        assigned = np.sum(has_event, axis=1)
        most_agree = agreeing > 0.5 * assigned
        return np.where(most_agree, 0.0, WRONG_NAMES)


def misfits_without_drift(
    camera_s: Array,
    late_s: Array,
    sigma_s: Array,
    drift_sigma: float,
) -> Array:
    """(k,) residuals ``late_s`` minus the likeliest drift of the camera's clock, in sigmas.

    ``late_s`` (k,) is event minus camera time after the offset [s]. Residuals of more than six
    sigmas do not count in the fit of the drift, which has a prior of 0 +- ``drift_sigma``.
    """
    near = np.abs(late_s) < WINDOW_SIGMAS * sigma_s
    since_middle = (camera_s - np.median(camera_s)) / sigma_s
    right = since_middle * late_s / sigma_s
    normal = np.sum(since_middle[near] ** 2) + drift_sigma**-2.0
    drift = np.sum(right[near]) / normal
    drifted = drift * since_middle
    return np.asarray(late_s / sigma_s - drifted)
