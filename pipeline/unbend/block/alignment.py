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

import numpy as np
from scipy.special import logsumexp

from unbend.units import Array, Integers, Mask

LOG_RATIO_NEEDED = float(np.log(1000.0))
"""What is 1000 times as likely as its rival is accepted."""

# Prices, as natural logarithms of probabilities: a run of images before or after all events, and
# each image of it; a run of events before or after all images (test shots, images that were not
# handed over); a repeat instead of its pulse. An image or event without a partner between others
# (lost pulses, deleted images) has at least these probabilities, or the share that is found.
_IMAGES_OUTSIDE, _EACH_OUTSIDE, _EVENTS_OUTSIDE = np.log(0.1), np.log(0.7), np.log(0.5)
_REPEAT = -3.0
_RAREST_IMAGE, _RAREST_EVENT = 0.03, 0.3

_MOST_VOTERS = 300
_WINDOW, _WIDEST = 6.0, 40  # sigmas within which an image may belong to an event, and most events
_MOST_PAIRS = 4_000_000  # of hypotheses, images and events at a time
_CONSTANT, _ODD = 0.05, 0.1  # intervals are constant that are whole multiples, but for these
_NEVER = -1e12


@dataclass(frozen=True, eq=False)
class Pairs:
    """Images and the events in their reach: (c, k, w) arrays, logarithms of probabilities."""

    weight: Array  # of a pair itself
    before: Array  # of all that comes before, where it is the first pair
    after: Array  # of all that comes after, where it is the last one
    low: Integers  # (c, k) the first event of w

    def reversed_from(self, events: int) -> Pairs:
        """The same, counted from the end."""
        turned = (slice(None), slice(None, None, -1), slice(None, None, -1))
        low = events - self.low[:, ::-1] - self.weight.shape[2]
        return Pairs(self.weight[turned], self.after[turned], self.before[turned], low)


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
    def interval(self) -> float:
        """Median interval of the events, without repeats."""
        pulses = self.events[np.append(True, np.diff(self.pulse) > 0)]
        return float(np.median(np.diff(pulses))) if pulses.size > 1 else np.inf

    def predicted(self, clocks: Array) -> Array:
        """(c, k) places of the images among the events, for (c, 2) offsets and drifts."""
        drifted = clocks[:, 1:] * (self.images - self.images.mean())
        return np.asarray(self.images + clocks[:, :1] + drifted)

    def partners(self, clocks: Array) -> Integers:
        """(c, k) the nearest event of each image within reach, -1 for none; no event twice."""
        predicted = self.predicted(clocks)
        nearest = _nearest(self.events, predicted)
        misfit = np.abs(self.events[nearest] - predicted) / self.sigma
        rows = np.full(nearest.shape, -1, np.int64)
        for near, far, row in zip(nearest, misfit, rows, strict=True):
            order = np.lexsort((far, near))
            first = order[np.append(True, np.diff(near[order]) > 0)]
            row[first] = np.where(far[first] <= _WINDOW, near[first], -1)
        return rows

    def candidate_offsets(self, most: int) -> Array:
        """Offsets at which many images meet an event: the highest peaks of all differences."""
        bin_width = max(0.5, 2.0 * float(np.median(self.sigma))) if self.is_time else 1.0
        count = min(self.images.size, _MOST_VOTERS)
        voters = np.unique(np.linspace(0, self.images.size - 1, count).astype(np.int64))
        offset = (self.events[None, :] - self.images[voters, None]).ravel()
        if np.isfinite(self.offset_sigma):
            offset = offset[np.abs(offset - self.offset) <= _WINDOW * self.offset_sigma + bin_width]
        if offset.size == 0:
            return np.array([self.offset])
        bins, votes = np.unique(np.floor(offset / bin_width).astype(np.int64), return_counts=True)
        if self.is_time:  # what falls on both sides of a border counts together
            follows = np.append(np.diff(bins) == 1, False)
            votes = votes + np.where(follows, np.roll(votes, -1), 0)
            before = np.append(False, follows[:-1]) & (np.roll(votes, 1) > votes)
            after = follows & (np.roll(votes, -1) >= votes)
            votes = np.where(before | after, 0, votes)
            bins = bins + 1
        highest = np.argsort(-votes, kind="stable")[:most]
        return np.asarray(bins[highest] * bin_width, np.float64)

    def with_sigma_shown(self, clocks: Array) -> Axis:
        """The axis with the sigma that the residuals of the best clock show, if that is larger."""
        predicted = self.predicted(clocks)
        misfit = np.abs(self.events[_nearest(self.events, predicted)] - predicted) / self.sigma
        spread = 1.4826 * float(np.median(misfit, axis=1).min()) if self.is_time else 1.0
        return replace(self, sigma=self.sigma * max(1.0, spread))

    def with_neighbours(self, clocks: Array) -> tuple[Array, tuple[float, float]]:
        """Clocks and those that shift the best one by up to six events; shares without a partner.

        The shares are those of images and of events under the best clock, or the least ones.
        """
        least = _RAREST_IMAGE, _RAREST_EVENT
        best = clocks[np.argmax(self.likelihoods(clocks, least))]
        rows = self.partners(best[None])[0]
        has = np.flatnonzero(rows >= 0)
        spans = (has[-1] - has[0] + 1, rows[has[-1]] - rows[has[0]] + 1) if has.size else (1, 1)
        images, events = (1.0 - max(1, has.size) / span for span in spans)
        near = _nearest(self.events, self.predicted(best[None])[0])
        steps = np.delete(np.arange(-6, 7), 6)
        beside = np.clip(near + steps[:, None], 0, self.events.size - 1)
        shifts = np.median(self.events[beside] - self.events[near], axis=1)
        clocks = np.concatenate([clocks, self.fitted(best[0] + shifts)])
        return clocks, (min(max(images, least[0]), 0.5), min(max(events, least[1]), 0.95))

    def fitted(self, offsets: Array) -> Array:
        """(c, 2) offsets and drifts: lines through the nearest events, robustly fitted."""
        clocks = np.stack([offsets, np.zeros(offsets.shape)], axis=1)
        if not self.is_time:
            return clocks
        x = self.images - self.images.mean()
        known = np.array([self.offset_sigma, self.drift_sigma]) ** -2.0
        for reach in (1.0, 0.7, 0.5, 0.35, 0.25, 0.0):
            predicted = self.predicted(clocks)
            residual = self.events[_nearest(self.events, predicted)] - predicted
            scale = np.maximum(reach, 3.0 * self.sigma)
            weight = self.sigma**-2 / (1.0 + (residual / scale) ** 2) ** 2
            normal = np.empty((offsets.size, 2, 2))
            normal[:, 0, 0] = weight.sum(axis=1) + known[0]
            normal[:, 0, 1] = normal[:, 1, 0] = weight @ x
            normal[:, 1, 1] = weight @ (x * x) + known[1]
            right = np.stack([np.sum(weight * residual, axis=1), (weight * residual) @ x], axis=1)
            right -= known * (clocks - [self.offset, 0.0])
            clocks = clocks + np.linalg.solve(normal, right[..., None])[..., 0]
        return clocks

    def pairs(self, clocks: Array, shares: tuple[float, float]) -> Pairs:
        """Images and the events in their reach, under each clock."""
        predicted, reach = self.predicted(clocks), _WINDOW * self.sigma
        low = np.searchsorted(self.events, predicted - reach)
        low = np.minimum.accumulate(low[:, ::-1], axis=1)[:, ::-1]
        high = np.searchsorted(self.events, predicted + reach, side="right")
        column = low[..., None] + np.arange(np.clip(np.max(high - low), 1, _WIDEST))
        there = np.minimum(column, self.events.size - 1)
        repeats = np.append(False, np.diff(self.pulse) == 0)[there]
        misfit = (self.events[there] - predicted[..., None]) / self.sigma[:, None]
        able = (column < self.events.size) & (np.abs(misfit) <= _WINDOW)
        rest, each = self.events.size - 1 - column, np.log(shares[1])
        count = np.arange(self.images.size)
        outside = np.where(count > 0, _IMAGES_OUTSIDE + count * _EACH_OUTSIDE, 0.0)[:, None]
        return Pairs(
            weight=np.where(able, 0.5 - 0.5 * misfit**2 + _REPEAT * repeats, _NEVER),
            before=outside + np.where(column > 0, _EVENTS_OUTSIDE + column * each, 0.0),
            after=outside[::-1] + np.where(rest > 0, _EVENTS_OUTSIDE + rest * each, 0.0),
            low=low,
        )

    def likelihoods(self, clocks: Array, shares: tuple[float, float]) -> Array:
        """(c,) log likelihood of each clock, with what is known of clocks beforehand."""
        total = np.empty(clocks.shape[0])
        at_once = max(1, _MOST_PAIRS // (self.images.size * 8))
        for start in range(0, total.size, at_once):
            pairs = self.pairs(clocks[start : start + at_once], shares)
            parts = _first_parts(pairs, shares) + pairs.after
            total[start : start + at_once] = logsumexp(parts, axis=(1, 2))
        if self.is_time:
            from_known = (clocks - [self.offset, 0.0]) / [self.offset_sigma, self.drift_sigma]
            total -= 0.5 * np.sum(from_known**2, axis=1)
        return total

    def price_of_pauses(self, clocks: Array, rows: Integers, shares: tuple[float, float]) -> Array:
        """(c,) log probability of the pauses in which there is neither an event nor an image.

        In a flight of constant intervals an assignment with one pair more also has one more place
        where both are missing: it is not more likely.
        """
        step = np.diff(self.events[np.append(True, np.diff(self.pulse) > 0)]) / self.interval
        odd = np.abs(step - np.rint(step)) > _CONSTANT
        if odd.sum() > _ODD * odd.size:  # the pauses of a survey are its turns
            return np.zeros(rows.shape[0])
        each = np.log(shares[0]) + np.log(shares[1]) - 0.5
        pauses = np.empty(rows.shape[0])
        between_images = np.median(np.diff(self.images)) if self.images.size > 1 else 0.0
        longest = 1.6 * max(self.interval, float(between_images))
        for h, (row, predicted) in enumerate(zip(rows, self.predicted(clocks), strict=True)):
            has = np.flatnonzero(row >= 0)
            between = slice(has[0], has[-1]) if has.size else slice(0)
            lonely = predicted[between][row[between] < 0]
            exposed = np.sort(np.concatenate([self.events, lonely]))
            pauses[h] = np.count_nonzero(np.diff(exposed) > longest)
        return np.asarray(each * pauses)

    def aligned(self, clock: Array, shares: tuple[float, float]) -> tuple[Integers, Mask]:
        """(k,) event of each image under one clock, -1 for none, and images between two events."""
        pairs = self.pairs(clock[None], shares)
        back = _first_parts(pairs.reversed_from(self.events.size), shares)[:, ::-1, ::-1]
        parts = _first_parts(pairs, shares)
        joint = (parts + back - pairs.weight)[0]
        able = pairs.weight[0] > _NEVER / 2
        log_p = np.where(able, joint - logsumexp(parts + pairs.after), -np.inf)
        best = np.argmax(log_p, axis=1)[:, None]
        highest = np.take_along_axis(log_p, best, 1)
        column = pairs.low[0][:, None] + np.arange(log_p.shape[1])
        pulse = self.pulse[np.minimum(column, self.pulse.size - 1)]
        same = pulse == np.take_along_axis(pulse, best, 1)
        rival = np.max(np.where(same, -np.inf, log_p), axis=1, keepdims=True)
        paired = logsumexp(log_p, axis=1) > np.log(0.5)
        ambiguous = paired & (rival > highest - LOG_RATIO_NEEDED)[:, 0]
        # Of a pulse and its repeats the first that is not 1000 times less likely than the best.
        first = np.argmax(same & (log_p >= highest - LOG_RATIO_NEEDED), axis=1)
        first = np.where(np.append(False, np.diff(pairs.low[0] + first) == 0), best[:, 0], first)
        rows = np.where(paired & ~ambiguous, pairs.low[0] + first, -1)
        rows[1:][np.diff(rows) == 0] = -1
        return rows, ambiguous


def _nearest(events: Array, places: Array) -> Integers:
    right = np.clip(np.searchsorted(events, places), min(1, events.size - 1), events.size - 1)
    left = np.maximum(right - 1, 0)
    return np.where(places - events[left] <= events[right] - places, left, right)


def _first_parts(pairs: Pairs, shares: tuple[float, float]) -> Array:
    """(c, k, w) log likelihood of all alignments that end with a pair (forward algorithm).

    ``ended`` are alignments up to an image and an event that end with a pair or with images without
    events, ``run`` the same with events without images behind; of what lies left of the window only
    their sum is kept, in the first place.
    """
    log_image, log_event = np.log(shares)
    count, images, width = pairs.weight.shape
    place, row = np.arange(width + 1), np.arange(count)[:, None]
    parts = np.empty_like(pairs.weight)
    ended = run = np.full((count, width + 1), _NEVER)
    low = pairs.low[:, 0]
    for i in range(images):
        source = (pairs.low[:, i] - low)[:, None] + place
        low, inside = pairs.low[:, i], np.minimum(source, width)
        run = run[row, inside] + log_event * (source - inside)
        ended = np.where(source <= width, ended[row, inside], _NEVER)
        ended[:, 0] = run[:, 0]
        parts[:, i] = pairs.weight[:, i] + np.logaddexp(run[:, :-1], pairs.before[:, i])
        ended = ended + log_image
        ended[:, 1:] = np.logaddexp(ended[:, 1:], parts[:, i])
        run = np.logaddexp.accumulate(ended - log_event * place, axis=1) + log_event * place
    return parts
