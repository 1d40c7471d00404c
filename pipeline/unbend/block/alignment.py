"""Two lists in order, events and images, aligned: each image has one event or none.

How to use it (see `assignment` for what events and images say)::

    axis = Axis(events=event_s, images=image_s, sigma=sigma_s, pulse=np.arange(event_s.size), ...)
    clocks = axis.fitted_clocks(axis.candidate_offsets(24))     # (c, 2) offsets and drifts
    clocks, shares = axis.with_shifted_clocks(clocks)
    score = axis.likelihoods(clocks, shares)                    # (c,) natural logarithms
    rows, ambiguous = axis.aligned(clocks[np.argmax(score)], shares)

A hypothesis is a clock: an offset (event minus image) and a drift. Its likelihood is the sum over
all alignments that keep the order (forward algorithm of a pair hidden Markov model: Durbin et al.,
Biological Sequence Analysis, 1998, chapter 4): Gaussian residuals, and a price (log probability)
for an event or an image without a partner. All hypotheses are computed at once, with the events
within six sigmas of each image: time grows with hypotheses times images.

Shapes: c clocks, k images, m events, w events in the window of an image.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.special import logsumexp

from unbend.units import Array, Integers, Mask

LOG_RATIO_NEEDED = float(np.log(1000.0))
"""A hypothesis is accepted if it is 1000 times as likely as its rival."""

# Prices, as natural logarithms of probabilities.
IMAGES_OUTSIDE = np.log(0.1)  # a run of images before or after all events ...
EACH_OUTSIDE = np.log(0.7)  # ... and each image of it
EVENTS_OUTSIDE = np.log(0.5)  # a run of events before or after all images, as of test shots
REPEAT = -3.0  # the image belongs to a repeat of a pulse, not to the pulse

REACHES_S = (1.0, 0.7, 0.5, 0.35, 0.25, 0.0)  # of residuals, in the rounds of a robust fit
LEAST_BIN_S = 0.5  # width of the bins in which offsets are counted
MAX_VOTERS = 300  # images that vote for an offset
WINDOW_SIGMAS = 6.0  # within which an image may belong to an event
MAX_WINDOW = 40  # events in reach of an image, at most
MAX_PAIRS = 4_000_000  # of hypotheses, images and events at a time: 32 MB an array
USUAL_WINDOW = 8  # events in reach of an image, as a rule
MULTIPLE_TOLERANCE = 0.05  # of the interval: a pause within it of a whole multiple is even
FEW_ODD = 0.1  # share of the pauses that are not even, up to which intervals are constant
LONG_PAUSE = 1.6  # intervals: in a longer pause an exposure is missing
SIGMA_OF_MAD = 1.4826  # sigmas of a normal distribution in its median absolute deviation
NEVER = -1e12  # log probability of what is impossible; finite, because inf - inf is NaN


class Shares(NamedTuple):
    """Shares of images (lost pulses) and of events (deleted images) without a partner."""

    images: float
    events: float

    def within(self, least: Shares, largest: Shares) -> Shares:
        """The shares, limited to a range."""
        images = max(self.images, least.images)
        events = max(self.events, least.events)
        return Shares(
            images=min(images, largest.images),
            events=min(events, largest.events),
        )


LEAST_SHARES = Shares(images=0.03, events=0.3)
LARGEST_SHARES = Shares(images=0.5, events=0.95)


@dataclass(frozen=True, eq=False)
class Pairs:
    """Possible pairs of images and events in their windows: (c, k, w) log probabilities."""

    weight: Array  # of the pair itself; NEVER for an event out of reach
    before: Array  # of all images and events before the pair, if it is the first one
    after: Array  # of all images and events after the pair, if it is the last one
    low: Integers  # (c, k) row of the first event in the window of an image

    def reversed_from(self, event_count: int) -> Pairs:
        """The same pairs, with images and events in reversed order."""
        width = self.weight.shape[2]
        first_behind = self.low[:, ::-1] + width  # the first event behind the window
        return Pairs(
            weight=self.weight[:, ::-1, ::-1],
            before=self.after[:, ::-1, ::-1],
            after=self.before[:, ::-1, ::-1],
            low=event_count - first_behind,
        )


@dataclass(frozen=True, eq=False)
class Axis:
    """Events and images in order on one axis: seconds of the log, or numbers.

    A clock (2,) is an offset, event minus image, at the mean of the images, and a drift.
    """

    events: Array  # (m,) ascending
    images: Array  # (k,) ascending
    sigma: Array  # (k,) standard deviations of ``images``
    pulse: Integers  # (m,) number of the pulse of an event: repeats of a pulse have the same
    image_rows: Integers  # (k,) rows of ``images`` in the list of the caller
    is_time: bool  # seconds; False for numbers
    offset: float = 0.0  # that is known beforehand
    offset_sigma: float = np.inf
    drift_sigma: float = 0.0  # of a known drift of 0

    @property
    def is_pulse(self) -> Mask:
        """(m,) whether an event is the first one of its pulse, and not a repeat."""
        is_new_pulse = np.diff(self.pulse) > 0
        return np.append(True, is_new_pulse)

    @property
    def interval(self) -> float:
        """Median interval of the events without repeats; infinite for one event."""
        pulses = self.events[self.is_pulse]
        if pulses.size < 2:
            return np.inf
        return float(np.median(np.diff(pulses)))

    def predicted(self, clocks: Array) -> Array:
        """(c, k) places of the images on the axis of the events, under (c, 2) clocks."""
        offset = clocks[:, :1]
        drift = clocks[:, 1:]
        drifted = drift * self.since_middle
        return np.asarray(self.images + offset + drifted)

    @property
    def since_middle(self) -> Array:
        """(k,) the images minus their mean, where a drift has no effect."""
        return np.asarray(self.images - self.images.mean(), np.float64)

    def residuals(self, clocks: Array) -> Array:
        """(c, k) nearest event minus image, under (c, 2) clocks."""
        predicted = self.predicted(clocks)
        nearest = nearest_events(self.events, predicted)
        return np.asarray(self.events[nearest] - predicted, np.float64)

    def partners(self, clocks: Array) -> Integers:
        """(c, k) row of the event that is nearest to each image, under (c, 2) clocks.

        -1 for an image without an event within six sigmas. If an event is nearest to several
        images, the one with the least misfit has it, and the others have -1.
        """
        predicted = self.predicted(clocks)
        nearest = nearest_events(self.events, predicted)
        apart = np.abs(self.events[nearest] - predicted)
        misfit = apart / self.sigma
        partners = np.full(nearest.shape, -1, np.int64)
        for event_of_image, misfits, partner in zip(nearest, misfit, partners, strict=True):
            order = np.lexsort((misfits, event_of_image))  # by event, then by misfit
            is_new_event = np.diff(event_of_image[order]) > 0
            best_images = order[np.append(True, is_new_event)]
            in_reach = misfits[best_images] <= WINDOW_SIGMAS
            partner[best_images] = np.where(in_reach, event_of_image[best_images], -1)
        return partners

    def candidate_offsets(self, most: int) -> Array:
        """At most ``most`` offsets at which many images meet an event, the most frequent first.

        They are peaks of the histogram of `pair_offsets`; the known offset if there are none.
        """
        offsets = self.pair_offsets()
        if offsets.size == 0:
            return np.array([self.offset])
        bin_of_offset = np.floor(offsets / self.bin_width)
        bins, votes = np.unique(bin_of_offset.astype(np.int64), return_counts=True)
        if self.is_time:  # a peak may fall on both sides of a border: two bins count together
            votes = votes_of_borders(bins, votes)
            bins = bins + 1  # the upper border of the bin is the middle of both
        highest = np.argsort(-votes, kind="stable")[:most]
        return np.asarray(bins[highest] * self.bin_width, np.float64)

    @property
    def bin_width(self) -> float:
        """Width of the bins in which offsets are counted."""
        if not self.is_time:
            return 1.0
        sigma = float(np.median(self.sigma))
        return max(LEAST_BIN_S, 2.0 * sigma)

    def pair_offsets(self) -> Array:
        """Event minus image of all events with up to `MAX_VOTERS` images, in one row.

        Only those within six sigmas of the known offset, if its sigma is finite.
        """
        voter_count = min(self.images.size, MAX_VOTERS)
        evenly = np.linspace(0, self.images.size - 1, voter_count)
        rows_of_voters = np.unique(evenly.astype(np.int64))
        voters = self.images[rows_of_voters, None]
        offsets = (self.events[None, :] - voters).ravel()
        if np.isfinite(self.offset_sigma):
            reach = WINDOW_SIGMAS * self.offset_sigma + self.bin_width
            offsets = offsets[np.abs(offsets - self.offset) <= reach]
        return offsets

    def with_sigma_inflated(self, clocks: Array) -> Axis:
        """The axis with all sigmas multiplied by one factor, so that the residuals fit them.

        The residuals are those under the clock with the least median misfit. The factor is at least
        1; on an axis of numbers it is 1.
        """
        if not self.is_time:
            return self
        misfit = np.abs(self.residuals(clocks)) / self.sigma
        median_misfit = np.median(misfit, axis=1)
        spread = SIGMA_OF_MAD * float(median_misfit.min())
        inflation = max(1.0, spread)
        return replace(self, sigma=self.sigma * inflation)

    def with_shifted_clocks(self, clocks: Array) -> tuple[Array, Shares]:
        """(c + 12, 2) the clocks, and the best one shifted by one to six events both ways.

        Returns also the shares without a partner under the best clock, within limits.
        """
        best = clocks[np.argmax(self.likelihoods(clocks, LEAST_SHARES))]
        shares = self.shares_without_partner(best).within(LEAST_SHARES, LARGEST_SHARES)
        predicted = self.predicted(best[None])[0]
        nearest = nearest_events(self.events, predicted)
        steps = np.delete(np.arange(-6, 7), 6)  # without 0
        shifted = nearest + steps[:, None]
        shifted = np.clip(shifted, 0, self.events.size - 1)
        shifts = self.events[shifted] - self.events[nearest]
        shift = np.median(shifts, axis=1)
        shifted_clocks = self.fitted_clocks(best[0] + shift)
        return np.concatenate([clocks, shifted_clocks]), shares

    def shares_without_partner(self, clock: Array) -> Shares:
        """The shares without a partner between the first and last pair, under one clock (2,)."""
        partner = self.partners(clock[None])[0]
        paired = np.flatnonzero(partner >= 0)
        image_span = 1
        event_span = 1
        if paired.size:
            first = paired[0]
            last = paired[-1]
            image_span = last - first + 1
            event_span = partner[last] - partner[first] + 1
        pairs = max(1, paired.size)
        return Shares(images=1.0 - pairs / image_span, events=1.0 - pairs / event_span)

    def fitted_clocks(self, offsets: Array) -> Array:
        """(c, 2) clocks, fitted robustly to the nearest events from some first offsets (c,).

        On an axis of numbers the offsets stay, without drift.
        """
        no_drift = np.zeros(offsets.shape)
        clocks = np.stack([offsets, no_drift], axis=1)
        if not self.is_time:
            return clocks
        for reach in REACHES_S:
            residual = self.residuals(clocks)
            scale = np.maximum(reach, 3.0 * self.sigma)
            robust = (1.0 + (residual / scale) ** 2) ** 2
            weight = self.sigma**-2 / robust
            clocks = clocks + self.clock_steps(clocks, weight, residual)
        return clocks

    def clock_steps(self, clocks: Array, weight: Array, residual: Array) -> Array:
        """(c, 2) changes of clocks by least squares, with the known offset and drift as priors.

        ``residual`` (c, k) are those of `residuals`, ``weight`` (c, k) their inverse variances.
        """
        x = self.since_middle
        prior_sigma = np.array([self.offset_sigma, self.drift_sigma])
        prior_weight = prior_sigma**-2.0
        from_prior = clocks - [self.offset, 0.0]
        normal = np.empty((clocks.shape[0], 2, 2))
        normal[:, 0, 0] = weight.sum(axis=1) + prior_weight[0]
        normal[:, 0, 1] = weight @ x
        normal[:, 1, 0] = normal[:, 0, 1]
        normal[:, 1, 1] = weight @ (x * x) + prior_weight[1]
        weighted = weight * residual
        right = np.empty(clocks.shape)
        right[:, 0] = np.sum(weighted, axis=1)
        right[:, 1] = weighted @ x
        right -= prior_weight * from_prior
        step = np.linalg.solve(normal, right[..., None])
        return np.asarray(step[..., 0])

    def pairs(self, clocks: Array, shares: Shares) -> Pairs:
        """Possible pairs of images and events under each clock (c, 2)."""
        predicted = self.predicted(clocks)
        window = self.windows_of_events(predicted)
        last = self.events.size - 1
        event = np.minimum(window, last)
        residual = self.events[event] - predicted[..., None]
        misfit = residual / self.sigma[:, None]
        price_of_repeat = REPEAT * ~self.is_pulse[event]
        weight = 0.5 - 0.5 * misfit**2 + price_of_repeat  # 0 for a mean square misfit of 1
        in_reach = (window <= last) & (np.abs(misfit) <= WINDOW_SIGMAS)
        images_before = price_of_images_outside(self.images.size)[:, None]
        images_after = images_before[::-1]
        return Pairs(
            weight=np.where(in_reach, weight, NEVER),
            before=images_before + price_of_events_outside(window, shares),
            after=images_after + price_of_events_outside(last - window, shares),
            low=window[..., 0],
        )

    def windows_of_events(self, predicted: Array) -> Integers:
        """(c, k, w) rows of the events from the first one in reach of each image (c, k) on.

        w is the same for all images: rows may be out of reach, or beyond the last event. First
        events do not descend from image to image.
        """
        reach = WINDOW_SIGMAS * self.sigma
        low = np.searchsorted(self.events, predicted - reach)
        from_last = np.minimum.accumulate(low[:, ::-1], axis=1)
        low = from_last[:, ::-1]
        high = np.searchsorted(self.events, predicted + reach, side="right")
        widest = np.max(high - low)
        width = np.clip(widest, 1, MAX_WINDOW)
        window = low[..., None] + np.arange(width)
        return np.asarray(window, np.int64)

    def likelihoods(self, clocks: Array, shares: Shares) -> Array:
        """(c,) log likelihood of each clock, with its prior: the known offset and drift."""
        total = np.empty(clocks.shape[0])
        at_once = max(1, MAX_PAIRS // (self.images.size * USUAL_WINDOW))
        for start in range(0, total.size, at_once):
            rows = slice(start, start + at_once)
            pairs = self.pairs(clocks[rows], shares)
            whole = likelihoods_of_endings(pairs, shares) + pairs.after
            total[rows] = logsumexp(whole, axis=(1, 2))
        if self.is_time:
            from_prior = clocks - [self.offset, 0.0]
            in_sigmas = from_prior / [self.offset_sigma, self.drift_sigma]
            total -= 0.5 * np.sum(in_sigmas**2, axis=1)
        return total

    def price_of_pauses(self, clocks: Array, partners: Integers, shares: Shares) -> Array:
        """(c,) log probability of the pauses where both an event and an image are missing.

        ``partners`` (c, k) are those under the clocks. In a flight with constant intervals, an
        assignment with one pair more also has one more such pause: it is not more likely. 0 in a
        flight without constant intervals.
        """
        pulses = self.events[self.is_pulse]
        intervals = np.diff(pulses) / self.interval
        is_odd = np.abs(intervals - np.rint(intervals)) > MULTIPLE_TOLERANCE
        if is_odd.sum() > FEW_ODD * is_odd.size:  # the pauses are the turns of a survey
            return np.zeros(partners.shape[0])
        image_interval = 0.0
        if self.images.size > 1:
            image_interval = float(np.median(np.diff(self.images)))
        longest = LONG_PAUSE * max(self.interval, image_interval)
        pauses = np.empty(partners.shape[0])
        predicted = self.predicted(clocks)
        for row, partner in enumerate(partners):
            images_alone = predicted[row][is_image_alone(partner)]
            exposures = np.sort(np.concatenate([self.events, images_alone]))
            pauses[row] = np.count_nonzero(np.diff(exposures) > longest)
        price_of_image = np.log(shares.images)
        price_of_event = np.log(shares.events)
        price = price_of_image + price_of_event - 0.5  # an exact pair has a weight of 0.5
        return np.asarray(price * pauses)

    def aligned(self, clock: Array, shares: Shares) -> tuple[Integers, Mask]:
        """(k,) row of the event of each image under one clock, and which images are ambiguous.

        -1 for an image that has probably no event, or an ambiguous one: two pulses are possible,
        with likelihoods within a factor of 1000. Of a pulse and its repeats, the first event within
        this factor of the best one is taken.
        """
        pairs = self.pairs(clock[None], shares)
        log_p = self.log_pair_probabilities(pairs, shares)
        low = pairs.low[0]
        best = np.argmax(log_p, axis=1)
        highest = np.max(log_p, axis=1)
        same_pulse = self.is_same_pulse(low, best, log_p.shape[1])
        log_p_of_others = np.where(same_pulse, -np.inf, log_p)
        rival = np.max(log_p_of_others, axis=1)
        paired = logsumexp(log_p, axis=1) > np.log(0.5)
        ambiguous = paired & (rival > highest - LOG_RATIO_NEEDED)

        likely = log_p >= highest[:, None] - LOG_RATIO_NEEDED
        first = np.argmax(same_pulse & likely, axis=1)
        is_same_event = np.diff(low + first) == 0
        taken_before = np.append(False, is_same_event)
        event = low + np.where(taken_before, best, first)
        event = np.where(paired & ~ambiguous, event, -1)
        event[1:][np.diff(event) == 0] = -1  # the image before has the same event already
        return event, ambiguous

    def is_same_pulse(self, low: Integers, best: Integers, width: int) -> Mask:
        """(k, w) whether the events of a window are of the same pulse as the ``best`` one in it.

        ``low`` (k,) is the first row of each window, ``best`` (k,) counts from there.
        """
        window = low[:, None] + np.arange(width)
        last = self.pulse.size - 1
        pulse = self.pulse[np.minimum(window, last)]
        pulse_of_best = np.take_along_axis(pulse, best[:, None], axis=1)
        return np.asarray(pulse == pulse_of_best, np.bool_)

    def log_pair_probabilities(self, pairs: Pairs, shares: Shares) -> Array:
        """(k, w) log probability of each pair of one clock, -inf out of reach."""
        # Forward-backward algorithm.
        log_up_to_pair = likelihoods_of_endings(pairs, shares)
        from_end = likelihoods_of_endings(pairs.reversed_from(self.events.size), shares)
        log_from_pair_on = from_end[:, ::-1, ::-1]
        log_joint = log_up_to_pair + log_from_pair_on - pairs.weight  # weights are in both
        log_of_all = logsumexp(log_up_to_pair + pairs.after)
        log_p = log_joint[0] - log_of_all  # one hypothesis: c = 1
        in_reach = pairs.weight[0] > NEVER / 2
        return np.where(in_reach, log_p, -np.inf)


def is_image_alone(partner: Integers) -> Mask:
    """(k,) images without an event (-1), between the first and the last image with one."""
    is_alone = np.zeros(partner.shape, np.bool_)
    paired = np.flatnonzero(partner >= 0)
    if paired.size:
        between = slice(paired[0], paired[-1])
        is_alone[between] = partner[between] < 0
    return is_alone


def nearest_events(events: Array, places: Array) -> Integers:
    """Row of the event nearest to each place; the earlier one of two that are equally near.

    ``events`` ascend; ``places`` have any shape.
    """
    last = events.size - 1
    right = np.searchsorted(events, places)
    right = np.clip(right, min(1, last), last)
    left = np.maximum(right - 1, 0)
    left_is_nearer = places - events[left] <= events[right] - places
    return np.where(left_is_nearer, left, right)


def votes_of_borders(bins: Integers, votes: Integers) -> Integers:
    """(b,) votes of each bin and the next one together; 0 where they are not a local maximum.

    ``bins`` (b,) are ascending numbers of the bins that have votes. Of two neighbours with equal
    sums the upper one counts.
    """
    has_next = np.append(np.diff(bins) == 1, False)
    has_previous = np.append(False, has_next[:-1])
    votes_of_next = np.where(has_next, np.roll(votes, -1), 0)
    together = votes + votes_of_next
    fewer_than_before = has_previous & (np.roll(together, 1) > together)
    no_more_than_after = has_next & (np.roll(together, -1) >= together)
    is_beside_peak = fewer_than_before | no_more_than_after
    return np.where(is_beside_peak, 0, together)


def price_of_images_outside(image_count: int) -> Array:
    """(k,) log probability that all images before each image are before the first event."""
    count = np.arange(image_count)
    return np.where(count > 0, IMAGES_OUTSIDE + count * EACH_OUTSIDE, 0.0)


def price_of_events_outside(count: Integers, shares: Shares) -> Array:
    """Log probability of a number of events before (or after) all images; 0 for no events."""
    price = EVENTS_OUTSIDE + count * np.log(shares.events)
    return np.where(count > 0, price, 0.0)


def likelihoods_of_endings(pairs: Pairs, shares: Shares) -> Array:
    """(c, k, w) log likelihood of all alignments up to and with each pair (forward algorithm).

    Two sums over alignments are carried from image to image, (c, w + 1) each. Place p of them: the
    first p events of the window are used or skipped. ``image_last`` are alignments that end with an
    image, with or without an event; ``any_last`` are the same, then any number of events without
    images. Place 0 has the sum over all places that the window has left behind.
    """
    log_image = np.log(shares.images)
    log_event = np.log(shares.events)
    count, images, width = pairs.weight.shape
    place = np.arange(width + 1)
    clock = np.arange(count)[:, None]
    endings = np.empty_like(pairs.weight)
    image_last = np.full((count, width + 1), NEVER)
    any_last = image_last
    low = pairs.low[:, 0]
    for image in range(images):
        # From the window of the image before to that of this image.
        moved = pairs.low[:, image] - low
        low = pairs.low[:, image]
        place_before = moved[:, None] + place
        inside = np.minimum(place_before, width)
        beyond = place_before - inside  # events that the window before did not reach
        any_last = any_last[clock, inside] + log_event * beyond
        image_last = np.where(place_before <= width, image_last[clock, inside], NEVER)
        image_last[:, 0] = any_last[:, 0]

        before = np.logaddexp(any_last[:, :-1], pairs.before[:, image])
        endings[:, image] = pairs.weight[:, image] + before
        image_last = image_last + log_image  # this image has no event, or one of the window
        image_last[:, 1:] = np.logaddexp(image_last[:, 1:], endings[:, image])
        skipped = log_event * place
        any_last = np.logaddexp.accumulate(image_last - skipped, axis=1) + skipped
    return endings
