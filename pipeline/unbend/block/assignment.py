"""Events to images by the best consistent assignment, with its runner-up.

How to use it, one camera at a time::

    events = CameraEvents(time_s, index=index)                 # of the log, in the order of time
    images = ImageEvidence(len(names), time_s=exif_s, sigma_s=12.0**-0.5,  # cut to whole seconds
                           number=number, numbering="counted")  # what the images say themselves
    found = assign(events, images)                             # or with first_image, tie_points
    if not found.accepted:                                     # found.reason, found.log_ratio ...
        ...
    rows = found.event                                         # (k,) row of events, -1 for none

A hypothesis is a clock (an offset and a drift of the camera's clock against the log's), or, where
the images have no times, what has to be added to their numbers; `alignment` gives its likelihood.
The runner-up is the best hypothesis that gives most images another event.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from unbend.block.alignment import LOG_RATIO_NEEDED, Axis
from unbend.flight.exposures import unwrapped_numbers
from unbend.units import Array, Integers, Mask

_WRONG_NAMES = -float(np.log(1e5))  # probability of names that are not what their pattern says
_COUNT_ROUND = 1 << 16
_MOST_HYPOTHESES, _MOST_WITH_POINTS = 24, 400
_HOPELESS = 60.0  # so far below the best one, a hypothesis is not shown to the tie points
_ENOUGH_MEET, _RIVALS = 0.8, 3  # of the most points that meet; rivals that are looked at closely
_LARGEST_SIGMA = 0.25  # of the median interval: chance alone gives 0.37
_MOST_AMBIGUOUS = 0.2  # of the images
_WINDOW = 6.0  # sigmas, beyond which a time says no more than that it does not fit


@dataclass(frozen=True, eq=False)
class CameraEvents:
    """Events of one camera in the order of their time.

    ``time_s`` (m,) of the log [s], from any origin; ``index`` (m,) the log's own numbers, which
    may count modulo 65536, or None.
    """

    time_s: Array
    index: Integers | None = None

    def __post_init__(self) -> None:
        if not np.all(np.isfinite(self.time_s)) or np.any(np.diff(self.time_s) < 0.0):
            raise ValueError("events are not in the order of their time")

    @property
    def repeated(self) -> Mask:
        """(m,) events that repeat the one before: a pulse that bounced or was logged twice.

        They follow within 0.2 s and a quarter of the shorter intervals (lower quartile), or have
        the same index.
        """
        step = np.diff(self.time_s)
        usual = step[step > 0.0]
        again = step < min(0.2, 0.25 * float(np.quantile(usual, 0.25)) if usual.size else 0.2)
        if self.index is not None:
            again |= np.diff(self.index) == 0
        return np.append(np.zeros(min(1, self.time_s.size), np.bool_), again)


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
        time, pulse = self.time_s, np.cumsum(~events.repeated).astype(np.int64)
        if time is not None and np.count_nonzero(np.isfinite(time)) >= 0.5 * self.count:
            tie = np.arange(self.count) if self.number is None else self.number
            order = np.lexsort((tie, time))[: np.count_nonzero(np.isfinite(time))]
            sigma = np.broadcast_to(self.sigma_s, time.shape)[order].astype(np.float64)
            return Axis(
                events.time_s, time[order], sigma, pulse, image_rows=order, is_time=True,
                offset=self.clock_offset_s, offset_sigma=self.clock_sigma_s,
                drift_sigma=self.drift_sigma,
            )  # fmt: skip
        place = np.arange(pulse.size) + 1 if self.numbering == "counted" else pulse
        if self.numbering != "counted" and events.index is not None:
            index = unwrapped_numbers(events.index)
            place = index if np.all(np.diff(index) >= 0) else place
        number = np.arange(self.count) if self.number is None else self.number
        if self.numbering == "index" and place.size:
            middle = int(place[0] + place[-1]) // 2 - _COUNT_ROUND // 2
            number = middle + (number - middle) % _COUNT_ROUND
        order = np.argsort(number, kind="stable")
        return Axis(
            place.astype(np.float64), number[order].astype(np.float64),
            np.full(self.count, 0.05), pulse, image_rows=order, is_time=False,
        )  # fmt: skip

    def names_speak(self, events: CameraEvents) -> bool:
        """Whether names say which event is whose: counted ones only where the counts are equal."""
        if self.number is None or self.numbering == "sequence" or self.count == 0:
            return False
        if self.numbering == "index":
            return events.index is not None
        total = int(self.number.max()) if self.total is None else self.total
        return total == events.time_s.size

    def rows_of_names(self, events: CameraEvents) -> Integers:
        """(k,) the row of the event that each name claims, -1 for none and where names say none."""
        claimed = np.full(self.count, -1, np.int64)
        if self.number is None or not self.names_speak(events):
            return claimed
        rows = range(events.time_s.size)
        number_of_row = np.array(rows) + 1
        if self.numbering == "index" and events.index is not None:
            number_of_row = events.index % _COUNT_ROUND
        row_of_number = dict(zip(number_of_row.tolist(), rows, strict=True))
        for image, number in enumerate(self.number.tolist()):
            claimed[image] = row_of_number.get(number % _COUNT_ROUND, -1)
        return claimed

    def offsets_of_names(self, events: CameraEvents, axis: Axis) -> Array:
        """(1,) the offset under which names are what their pattern says; (0,) where they are mute.

        It is a hypothesis even where many others bring as many images to an event.
        """
        claimed = self.rows_of_names(events)[axis.image_rows]
        has = claimed >= 0
        if not has.any():
            return np.empty(0)
        apart = axis.events[claimed[has]] - axis.images[has]
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
        timed = np.flatnonzero((rows >= 0) & np.isfinite(self.time_s))
        if timed.size == 0:
            return 0.0
        camera_s = self.time_s[timed]
        sigma_of_image = np.broadcast_to(self.sigma_s, self.time_s.shape)
        sigma = np.maximum(sigma_of_image[timed], sigma_s)
        late_s = events.time_s[rows[timed]] - camera_s
        offset_s = float(np.median(late_s))
        late_s = late_s - offset_s
        near = np.abs(late_s) < _WINDOW * sigma
        middle_s = np.median(camera_s)
        since_middle = (camera_s - middle_s) / sigma
        normal = np.sum(since_middle[near] ** 2) + self.drift_sigma**-2.0
        drift = np.sum((since_middle * late_s / sigma)[near]) / normal
        misfit = late_s / sigma - drift * since_middle
        of_clock = (offset_s - self.clock_offset_s) / self.clock_sigma_s
        cost = np.minimum(misfit**2, _WINDOW**2)
        total = cost.sum() + of_clock**2
        return -0.5 * float(total)

    def log_prior_of_names(self, events: CameraEvents, rows: Integers) -> Array:
        """(c,) log probability of assignments (c, k) by what the pattern of the names claims."""
        if not self.names_speak(events) or self.number is None:
            return np.zeros(rows.shape[0])
        agrees = rows + 1 == self.number
        if self.numbering == "index" and events.index is not None:
            agrees = (events.index[rows] - self.number) % _COUNT_ROUND == 0
        has = rows >= 0
        return np.where(np.sum(agrees & has, axis=1) > 0.5 * np.sum(has, axis=1), 0.0, _WRONG_NAMES)


@dataclass(frozen=True, eq=False)
class Assignment:
    """The best assignment of events to images (k,), and how much better it is than its rival."""

    event: Integers  # row of the event of each image, -1 for none
    residual_s: Array  # event minus image time after offset and drift, NaN without times
    ambiguous: Mask  # between two events, of which neither is 1000 times as likely: they have none
    repeated: Mask  # (m,) as of `CameraEvents`
    runner_up: Integers  # events of the best rival
    log_ratio: float  # natural logarithm of the likelihood ratio, infinite without a rival
    reason: str  # why it is refused, or empty
    evidence: tuple[str, ...]  # what has spoken
    offset_s: float = np.nan  # event minus camera time at the middle image
    drift: float = np.nan
    sigma_s: float = np.nan  # what the residuals show of one image's time

    @property
    def accepted(self) -> bool:
        """Whether it may be used."""
        return not self.reason

    @property
    def shift(self) -> int:
        """By how many events the runner-up differs (median); 0 without one."""
        both = (self.runner_up >= 0) & (self.event >= 0)
        return int(np.median((self.runner_up - self.event)[both])) if np.any(both) else 0


def assign(
    events: CameraEvents, images: ImageEvidence, *, first_image: tuple[int, int] | None = None,
    tie_points: Callable[[Integers], float] | None = None, share_met: Callable[[Integers], Array] |
    None = None,
) -> Assignment:  # fmt: skip
    """Assign events to images by all that both say.

    Parameters
    ----------
    first_image : (row of an image, row of its event), stated by the user.
    tie_points : natural logarithm of the likelihood of an assignment ((k,) rows of events, -1 for
        none) by rays that intersect; called for up to some hundred hypotheses.
    share_met : (c,) share of tie points whose rays meet under assignments (c, k), which costs
        little: ``tie_points`` is then called only for those that can win, and some rivals.

    Refused (``reason``) where the runner-up's likelihood is not 1000 times smaller, where unequal
    counts have only ``counted`` names, where fewer than half of the images find an event, where the
    times fit no better than by chance, and where ``first_image`` contradicts the rest.

    >>> times = np.array([0.0, 3.0, 6.1, 9.0, 40.0, 43.1, 46.0, 49.0])
    >>> camera_clock = ImageEvidence(5, time_s=times[2:7] + 7200.0, sigma_s=0.05)
    >>> assign(CameraEvents(times), camera_clock).event.tolist()
    [2, 3, 4, 5, 6]
    """
    axis = images.axis(events)
    place = np.flatnonzero(axis.image_rows == first_image[0]) if first_image else np.array([0])
    if min(axis.events.size, axis.images.size, place.size) == 0:
        reason = "there are no events, or no times of the images that should have one"
        return _empty(events, images, reason)
    offsets = axis.candidate_offsets(_MOST_WITH_POINTS if tie_points else _MOST_HYPOTHESES)
    offsets = np.append(offsets, images.offsets_of_names(events, axis))
    if first_image is not None:
        offsets = np.append(offsets, axis.events[first_image[1]] - axis.images[place[0]])
    axis = axis.with_sigma_shown(axis.fitted(offsets))
    clocks, shares = axis.with_neighbours(axis.fitted(offsets))
    partners = axis.partners(clocks)
    rows = np.full((clocks.shape[0], images.count), -1, np.int64)
    rows[:, axis.image_rows] = partners
    score = axis.likelihoods(clocks, shares) + axis.price_of_pauses(clocks, partners, shares)
    score += images.log_prior_of_names(events, rows)
    if tie_points is not None:
        hopeful = score > score.max() - _HOPELESS
        different, which = np.unique(rows[hopeful], axis=0, return_inverse=True)
        by_points = likelihoods_by_points(different, tie_points, share_met)
        score[hopeful] += by_points[which.ravel()]
        score[~hopeful] += by_points.min()
    pulses = np.where(rows >= 0, axis.pulse[rows], -1)
    able = np.ones(score.shape, np.bool_)
    if first_image is not None:
        able = pulses[:, first_image[0]] == axis.pulse[first_image[1]]
    best = int(np.argmax(np.where(able, score, -np.inf)))
    changed = np.sum(pulses != pulses[best], axis=1)
    rivals = able & (changed > 0.5 * np.sum((rows >= 0) | (rows[best] >= 0), axis=1))
    second = int(np.argmax(np.where(rivals, score, -np.inf)))
    names = images.names_speak(events) or (images.number is not None and not axis.is_time)
    spoken = {
        "times": axis.is_time,
        f"names ({images.numbering})": names,
        "order": not axis.is_time and images.number is None,
        "tie points": tie_points is not None,
        "first_image": first_image is not None,
    }
    found = replace(
        _empty(events, images, ""),
        log_ratio=float(score[best] - score[second]) if rivals[second] else np.inf,
        runner_up=rows[second] if rivals[second] else rows[second] * 0 - 1,
        evidence=tuple(name for name, has in spoken.items() if has),
    )
    chosen, found.ambiguous[axis.image_rows] = axis.aligned(clocks[best], shares)
    found.event[axis.image_rows] = chosen
    if axis.is_time:
        residual = axis.events[chosen] - axis.predicted(clocks[[best]])[0]
        found.residual_s[axis.image_rows] = np.where(chosen >= 0, residual, np.nan)
        sigma = float(axis.sigma.mean())
        offset, drift = clocks[best].tolist()
        found = replace(found, offset_s=offset, drift=drift, sigma_s=sigma)
    # Prices of missing events and images alone are no evidence against what was stated.
    has_evidence = axis.is_time or tie_points is not None or images.names_speak(events)
    against = has_evidence * float(score.max() - score[best])
    return replace(found, reason=why_refused(found, events, images, axis, against))


def likelihoods_by_points(
    rows: Integers,
    tie_points: Callable[[Integers], float],
    share_met: Callable[[Integers], Array] | None,
) -> Array:
    """(c,) log likelihoods; that of an assignment at which too few points meet is the least one.

    Where fewer than half meet at best, every one is computed.
    """
    closely = np.ones(rows.shape[0], np.bool_)
    if share_met is not None and (met := share_met(rows)).max() >= 0.5:
        closely = met >= _ENOUGH_MEET * met.max()
        other = np.mean(rows != rows[np.argmax(met)], axis=1) > 0.5
        closely[np.argsort(-np.where(other, met, -1.0), kind="stable")[:_RIVALS]] = True
    value = np.array([tie_points(event) for event in rows[closely]])
    result = np.full(closely.shape, value.min())
    result[closely] = value
    return result


def _empty(events: CameraEvents, images: ImageEvidence, reason: str) -> Assignment:
    none, unknown = np.full(images.count, -1, np.int64), np.full(images.count, np.nan)
    nothing = np.zeros(images.count, np.bool_)
    return Assignment(none, unknown, nothing, events.repeated, none.copy(), 0.0, reason, ())


def why_refused(
    found: Assignment, events: CameraEvents, images: ImageEvidence, axis: Axis, against: float
) -> str:
    """Why an assignment is not accepted, or nothing. ``against`` is how much better another is."""
    between = int(np.count_nonzero(found.ambiguous))
    has = int(np.count_nonzero(found.event >= 0)) + between
    if against > LOG_RATIO_NEEDED:
        return f"the image and its event that were stated contradict the rest by e^{against:.0f}"
    if has < 0.5 * images.count:
        return f"only {has} of {images.count} images find an event"
    if between > _MOST_AMBIGUOUS * images.count:
        return f"{between} of {images.count} images lie between two events"
    if axis.is_time and found.sigma_s > _LARGEST_SIGMA * axis.interval:
        sizes = f"residuals of {found.sigma_s:.2g} s, events {axis.interval:.2g} s apart"
        return f"the times fit no better than by chance: {sizes}"
    if axis.is_time and has < 3 and len(found.evidence) == 1 and np.isinf(axis.offset_sigma):
        return f"{has} images have no rhythm"
    if found.log_ratio >= LOG_RATIO_NEEDED:
        return ""
    if found.evidence[-1] == "names (counted)" and not images.names_speak(events):
        counts = f"counted up to {int(np.max(axis.images))} and {events.time_s.size} events"
        why = "numbers alone do not decide which image has which event"
        return f"{images.count} images {counts}: {why}"
    times = f"{np.exp(max(0.0, found.log_ratio)):.3g} times less likely"
    return f"shifted by {found.shift:+d} events it is only {times}"
