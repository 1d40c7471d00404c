"""Two lists in order, events and images, aligned: each image has one event or none.

How to use it (see `assignment` for what events and images say)::

    axis = Axis(events=event_s, images=image_s, sigma=sigma_s, pulse=np.arange(event_s.size), ...)
    clocks, shares = axis.with_neighbours(axis.fitted(axis.candidate_offsets(24)))
    score = axis.likelihoods(clocks, shares)                    # (c,) natural logarithms
    rows, ambiguous = axis.aligned(clocks[np.argmax(score)], shares)

A hypothesis is an offset between both, and a drift. Its likelihood is the sum over all alignments
that keep the order (forward algorithm of a pair hidden Markov model: Durbin et al., Biological
Sequence Analysis, 1998, chapter 4): Gaussian residuals, and a price for what has no partner. Rows
are aligned for all hypotheses at once, within six sigmas: time goes with their number times images.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.special import logsumexp

from unbend.units import Array, Integers, Mask

LOG_RATIO_NEEDED = float(np.log(1000.0))
"""What is 1000 times as likely as its rival is accepted."""

# Prices, as natural logarithms of probabilities.
IMAGES_OUTSIDE = np.log(0.1)  # a run of images before or after all events ...
EACH_OUTSIDE = np.log(0.7)  # ... and each image of it
EVENTS_OUTSIDE = np.log(0.5)  # a run of events beside all images, of test shots for example
REPEAT = -3.0  # a repeat instead of its pulse

REACHES_S = (1.0, 0.7, 0.5, 0.35, 0.25, 0.0)  # of residuals that count in robust fits
LEAST_BIN_S = 0.5  # in which offsets are counted
MAX_VOTERS = 300  # images that vote for an offset
WINDOW_SIGMAS = 6.0  # within which an image may belong to an event
MAX_WINDOW = 40  # events in reach of an image, at most
MAX_PAIRS = 4_000_000  # of hypotheses, images and events at a time: 32 MB an array
USUAL_WINDOW = 8  # events in reach of an image, as a rule
CONSTANT = 0.05  # of an interval: pauses are whole multiples of it as well as this ...
FEW_ODD = 0.1  # ... but for this share of them, where intervals are constant
LONG_PAUSE = 1.6  # intervals between two exposures, of which one between is missing
SIGMA_OF_MAD = 1.4826  # sigmas of a normal distribution in its median absolute deviation
NEVER = -1e12


class Shares(NamedTuple):
    """Shares of the images, and of the events, that have no partner between others.

    Lost pulses and deleted images.
    """

    images: float
    events: float

    def within(self, least: Shares, largest: Shares) -> Shares:
        """The nearest shares between two limits."""
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
    """Images and the events in their reach: (c, k, w) arrays, logarithms of probabilities."""

    weight: Array  # of a pair itself
    before: Array  # of all that comes before, where it is the first pair
    after: Array  # of all that comes after, where it is the last one
    low: Integers  # (c, k) the first event of w

    def reversed_from(self, event_count: int) -> Pairs:
        """The same, with images and events counted from the last one."""
        width = self.weight.shape[2]
        first_behind = self.low[:, ::-1] + width  # the first event behind those of w
        return Pairs(
            weight=self.weight[:, ::-1, ::-1],
            before=self.after[:, ::-1, ::-1],
            after=self.before[:, ::-1, ::-1],
            low=event_count - first_behind,
        )


@dataclass(frozen=True, eq=False)
class Axis:
    """Events and images in order on one axis: seconds of the log, or numbers."""

    events: Array  # (m,) ascending
    images: Array  # (k,) ascending, those of the rows ``image_rows``
    sigma: Array  # (k,)
    pulse: Integers  # (m,) which pulse an event is of: its repeats have the same
    image_rows: Integers
    is_time: bool
    offset: float = 0.0  # known beforehand, with its sigma and that of a drift
    offset_sigma: float = np.inf
    drift_sigma: float = 0.0

    @property
    def is_pulse(self) -> Mask:
        """(m,) the events that do not repeat another one."""
        is_another = np.diff(self.pulse) > 0
        return np.append(True, is_another)

    @property
    def interval(self) -> float:
        """Median interval of the events, without repeats."""
        pulses = self.events[self.is_pulse]
        if pulses.size < 2:
            return np.inf
        return float(np.median(np.diff(pulses)))

    def predicted(self, clocks: Array) -> Array:
        """(c, k) places of the images among the events, for (c, 2) offsets and drifts."""
        offset = clocks[:, :1]
        drift = clocks[:, 1:]
        drifted = drift * self.since_middle
        return np.asarray(self.images + offset + drifted)

    @property
    def since_middle(self) -> Array:
        """(k,) the images from their mean, at which a drift is 0."""
        return np.asarray(self.images - self.images.mean(), np.float64)

    def residuals(self, clocks: Array) -> Array:
        """(c, k) by which the nearest event is after each image."""
        predicted = self.predicted(clocks)
        nearest = nearest_events(self.events, predicted)
        return np.asarray(self.events[nearest] - predicted, np.float64)

    def partners(self, clocks: Array) -> Integers:
        """(c, k) the nearest event of each image within reach, -1 for none; no event twice."""
        predicted = self.predicted(clocks)
        nearest = nearest_events(self.events, predicted)
        apart = np.abs(self.events[nearest] - predicted)
        misfit = apart / self.sigma
        partners = np.full(nearest.shape, -1, np.int64)
        for events, misfits, partner in zip(nearest, misfit, partners, strict=True):
            order = np.lexsort((misfits, events))
            is_another = np.diff(events[order]) > 0
            first = order[np.append(True, is_another)]
            in_reach = misfits[first] <= WINDOW_SIGMAS
            partner[first] = np.where(in_reach, events[first], -1)
        return partners

    def candidate_offsets(self, most: int) -> Array:
        """Offsets at which many images meet an event: the highest peaks of all differences."""
        offset = self.differences()
        if offset.size == 0:
            return np.array([self.offset])
        bin_of_offset = np.floor(offset / self.bin_width)
        bins, votes = np.unique(bin_of_offset.astype(np.int64), return_counts=True)
        if self.is_time:  # what falls on both sides of a border counts together
            votes = votes_of_borders(bins, votes)
            bins = bins + 1
        highest = np.argsort(-votes, kind="stable")[:most]
        return np.asarray(bins[highest] * self.bin_width, np.float64)

    @property
    def bin_width(self) -> float:
        """Width of the bins in which offsets are counted."""
        if not self.is_time:
            return 1.0
        sigma = float(np.median(self.sigma))
        return max(LEAST_BIN_S, 2.0 * sigma)

    def differences(self) -> Array:
        """All differences of events and some images that a known offset allows."""
        voter_count = min(self.images.size, MAX_VOTERS)
        evenly = np.linspace(0, self.images.size - 1, voter_count)
        voters = np.unique(evenly.astype(np.int64))
        voter = self.images[voters, None]
        offset = (self.events[None, :] - voter).ravel()
        if np.isfinite(self.offset_sigma):
            reach = WINDOW_SIGMAS * self.offset_sigma + self.bin_width
            offset = offset[np.abs(offset - self.offset) <= reach]
        return offset

    def with_sigma_inflated(self, clocks: Array) -> Axis:
        """The axis with all sigmas enlarged by one factor, to the spread of its residuals.

        Those of the clock with the least median misfit; sigmas are never reduced. An axis of
        numbers keeps its sigma.
        """
        if not self.is_time:
            return self
        misfit = np.abs(self.residuals(clocks)) / self.sigma
        median_misfit = np.median(misfit, axis=1)
        spread = SIGMA_OF_MAD * float(median_misfit.min())
        inflation = max(1.0, spread)
        return replace(self, sigma=self.sigma * inflation)

    def with_neighbours(self, clocks: Array) -> tuple[Array, Shares]:
        """Clocks and those that shift the best one by up to six events; shares without a partner.

        The shares are those of images and of events under the best clock, within limits.
        """
        best = clocks[np.argmax(self.likelihoods(clocks, LEAST_SHARES))]
        shares = self.shares_without_partner(best).within(LEAST_SHARES, LARGEST_SHARES)
        predicted = self.predicted(best[None])[0]
        near = nearest_events(self.events, predicted)
        steps = np.delete(np.arange(-6, 7), 6)  # without 0
        beside = near + steps[:, None]
        beside = np.clip(beside, 0, self.events.size - 1)
        shifts = self.events[beside] - self.events[near]
        shift = np.median(shifts, axis=1)
        neighbours = self.fitted(best[0] + shift)
        return np.concatenate([clocks, neighbours]), shares

    def shares_without_partner(self, clock: Array) -> Shares:
        """The shares under one clock, between the first and the last pair."""
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

    def fitted(self, offsets: Array) -> Array:
        """(c, 2) offsets and drifts: lines through the nearest events, robustly fitted."""
        no_drift = np.zeros(offsets.shape)
        clocks = np.stack([offsets, no_drift], axis=1)
        if not self.is_time:
            return clocks
        for reach in REACHES_S:
            residual = self.residuals(clocks)
            scale = np.maximum(reach, 3.0 * self.sigma)
            robust = (1.0 + (residual / scale) ** 2) ** 2
            weight = self.sigma**-2 / robust
            clocks = clocks + self.step_of_clocks(clocks, weight, residual)
        return clocks

    def step_of_clocks(self, clocks: Array, weight: Array, residual: Array) -> Array:
        """(c, 2) least-squares changes of clocks by weighted residuals (c, k) and their priors."""
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
        """Images and the events in their reach, under each clock."""
        predicted = self.predicted(clocks)
        column = self.columns_in_reach(predicted)
        last = self.events.size - 1
        event = np.minimum(column, last)
        residual = self.events[event] - predicted[..., None]
        misfit = residual / self.sigma[:, None]
        price_of_repeat = REPEAT * ~self.is_pulse[event]
        weight = 0.5 - 0.5 * misfit**2 + price_of_repeat
        in_reach = (column <= last) & (np.abs(misfit) <= WINDOW_SIGMAS)
        images_before = price_of_images_outside(self.images.size)[:, None]
        images_after = images_before[::-1]
        return Pairs(
            weight=np.where(in_reach, weight, NEVER),
            before=images_before + price_of_events_outside(column, shares),
            after=images_after + price_of_events_outside(last - column, shares),
            low=column[..., 0],
        )

    def columns_in_reach(self, predicted: Array) -> Integers:
        """(c, k, w) events from the first one in reach of an image; beyond the last one as well.

        No first event is before that of an earlier image.
        """
        reach = WINDOW_SIGMAS * self.sigma
        low = np.searchsorted(self.events, predicted - reach)
        from_last = np.minimum.accumulate(low[:, ::-1], axis=1)
        low = from_last[:, ::-1]
        high = np.searchsorted(self.events, predicted + reach, side="right")
        widest = np.max(high - low)
        width = np.clip(widest, 1, MAX_WINDOW)
        column = low[..., None] + np.arange(width)
        return np.asarray(column, np.int64)

    def likelihoods(self, clocks: Array, shares: Shares) -> Array:
        """(c,) log likelihood of each clock, with what is known of clocks beforehand."""
        total = np.empty(clocks.shape[0])
        at_once = max(1, MAX_PAIRS // (self.images.size * USUAL_WINDOW))
        for start in range(0, total.size, at_once):
            rows = slice(start, start + at_once)
            pairs = self.pairs(clocks[rows], shares)
            whole = likelihoods_of_endings(pairs, shares) + pairs.after
            total[rows] = logsumexp(whole, axis=(1, 2))
        if self.is_time:
            off = clocks - [self.offset, 0.0]
            in_sigmas = off / [self.offset_sigma, self.drift_sigma]
            total -= 0.5 * np.sum(in_sigmas**2, axis=1)
        return total

    def price_of_pauses(self, clocks: Array, partners: Integers, shares: Shares) -> Array:
        """(c,) log probability of the pauses in which there is neither an event nor an image.

        In a flight of constant intervals an assignment with one pair more also has one more place
        where both are missing: it is not more likely.
        """
        pulses = self.events[self.is_pulse]
        intervals = np.diff(pulses) / self.interval
        is_odd = np.abs(intervals - np.rint(intervals)) > CONSTANT
        if is_odd.sum() > FEW_ODD * is_odd.size:  # the pauses of a survey are its turns
            return np.zeros(partners.shape[0])
        image_interval = 0.0
        if self.images.size > 1:
            image_interval = float(np.median(np.diff(self.images)))
        longest = LONG_PAUSE * max(self.interval, image_interval)
        pauses = np.empty(partners.shape[0])
        predicted = self.predicted(clocks)
        for k, partner in enumerate(partners):
            lonely = predicted[k][is_lonely(partner)]
            exposed = np.sort(np.concatenate([self.events, lonely]))
            pauses[k] = np.count_nonzero(np.diff(exposed) > longest)
        price_of_image = np.log(shares.images)
        price_of_event = np.log(shares.events)
        price = price_of_image + price_of_event - 0.5
        return np.asarray(price * pauses)

    def aligned(self, clock: Array, shares: Shares) -> tuple[Integers, Mask]:
        """(k,) event of each image under one clock, -1 for none, and images between two events.

        Of a pulse and its repeats it is the first that is not 1000 times less likely than the best.
        """
        pairs = self.pairs(clock[None], shares)
        log_p = self.log_pair_probabilities(pairs, shares)
        low = pairs.low[0]
        best = np.argmax(log_p, axis=1)
        highest = np.max(log_p, axis=1)
        same_pulse = self.is_pulse_of(low, best, log_p.shape[1])
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
        event[1:][np.diff(event) == 0] = -1
        return event, ambiguous

    def is_pulse_of(self, low: Integers, best: Integers, width: int) -> Mask:
        """(k, w) events from the row ``low`` on that are of the same pulse as the ``best`` one."""
        column = low[:, None] + np.arange(width)
        last = self.pulse.size - 1
        pulse = self.pulse[np.minimum(column, last)]
        pulse_of_best = np.take_along_axis(pulse, best[:, None], axis=1)
        return np.asarray(pulse == pulse_of_best, np.bool_)

    def log_pair_probabilities(self, pairs: Pairs, shares: Shares) -> Array:
        """(k, w) logarithm of the probability of each pair (forward-backward algorithm).

        The pairs are those of one clock. Pairs out of reach have -inf.
        """
        log_up_to_pair = likelihoods_of_endings(pairs, shares)
        from_end = likelihoods_of_endings(pairs.reversed_from(self.events.size), shares)
        log_from_pair_on = from_end[:, ::-1, ::-1]
        log_joint = log_up_to_pair + log_from_pair_on - pairs.weight  # which is in both
        log_of_all = logsumexp(log_up_to_pair + pairs.after)
        log_p = log_joint[0] - log_of_all  # one hypothesis: c = 1
        in_reach = pairs.weight[0] > NEVER / 2
        return np.where(in_reach, log_p, -np.inf)


def is_lonely(partner: Integers) -> Mask:
    """(k,) images without an event between the first and the last image with one."""
    lonely = np.zeros(partner.shape, np.bool_)
    paired = np.flatnonzero(partner >= 0)
    if paired.size:
        between = slice(paired[0], paired[-1])
        lonely[between] = partner[between] < 0
    return lonely


def nearest_events(events: Array, places: Array) -> Integers:
    """Rows of the nearest events (ascending); of two as near the earlier one."""
    last = events.size - 1
    right = np.searchsorted(events, places)
    right = np.clip(right, min(1, last), last)
    left = np.maximum(right - 1, 0)
    left_is_nearer = places - events[left] <= events[right] - places
    return np.where(left_is_nearer, left, right)


def votes_of_borders(bins: Integers, votes: Integers) -> Integers:
    """Votes on both sides of the upper border of each bin; 0 where a border beside has more."""
    has_next = np.append(np.diff(bins) == 1, False)
    has_previous = np.append(False, has_next[:-1])
    votes_of_next = np.where(has_next, np.roll(votes, -1), 0)
    together = votes + votes_of_next
    fewer_than_before = has_previous & (np.roll(together, 1) > together)
    no_more_than_after = has_next & (np.roll(together, -1) >= together)
    is_beside_peak = fewer_than_before | no_more_than_after
    return np.where(is_beside_peak, 0, together)


def price_of_images_outside(images: int) -> Array:
    """(k,) of the images before each one, if all of them are before the first event."""
    count = np.arange(images)
    return np.where(count > 0, IMAGES_OUTSIDE + count * EACH_OUTSIDE, 0.0)


def price_of_events_outside(count: Integers, shares: Shares) -> Array:
    """Of a number of events that are before, or after, all images."""
    price = EVENTS_OUTSIDE + count * np.log(shares.events)
    return np.where(count > 0, price, 0.0)


def likelihoods_of_endings(pairs: Pairs, shares: Shares) -> Array:
    """(c, k, w) log likelihood of all alignments up to and with each pair (forward algorithm).

    From image to image two sums of alignments are carried on, for each place of the window: those
    that end with a pair or with images without events, and the same with events without images
    behind. Of what lies left of the window only the sum is kept, in the first place.
    """
    log_image = np.log(shares.images)
    log_event = np.log(shares.events)
    count, images, width = pairs.weight.shape
    place = np.arange(width + 1)
    clock = np.arange(count)[:, None]
    endings = np.empty_like(pairs.weight)
    ended = np.full((count, width + 1), NEVER)  # with a pair, or images without events
    run = ended  # with events without images behind
    low = pairs.low[:, 0]
    for i in range(images):
        moved = pairs.low[:, i] - low
        low = pairs.low[:, i]
        source = moved[:, None] + place
        inside = np.minimum(source, width)
        beyond = source - inside
        run = run[clock, inside] + log_event * beyond
        ended = np.where(source <= width, ended[clock, inside], NEVER)
        ended[:, 0] = run[:, 0]
        before = np.logaddexp(run[:, :-1], pairs.before[:, i])
        endings[:, i] = pairs.weight[:, i] + before
        ended = ended + log_image
        ended[:, 1:] = np.logaddexp(ended[:, 1:], endings[:, i])
        skipped = log_event * place
        run = np.logaddexp.accumulate(ended - skipped, axis=1) + skipped
    return endings
