"""Flights drawn at random with the true assignment of their events to images.

Independent of the package: times of exposures by distance along lines with wind, turns between the
lines, what gets lost, repeated or fired on the ground, and the camera's clock.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

KINDS = (
    "first missing",
    "last missing",
    "random missing",
    "test shots",
    "doubled",
    "lost pulses",
    "log begins late",
    "two cameras",
    "everything",
)


@dataclass
class Drawn:
    """A flight of one camera: what the program gets, and the truth."""

    kind: str
    constant: bool  # intervals without wind and turns
    milliseconds: bool  # in the images' times
    event_s: np.ndarray
    event_index: np.ndarray
    image_s: np.ndarray  # by the camera's clock
    image_number: np.ndarray  # the camera's own
    truth: np.ndarray  # row of the event of each image, -1 where its pulse was lost
    bounced: np.ndarray  # rows of events that repeat another

    @property
    def sigma_s(self) -> float:
        return 0.02 if self.milliseconds else 12.0**-0.5


def draw(rng: np.random.Generator, kind: str, *, constant: bool = False) -> Drawn:
    exposed = _exposures(rng, constant)
    has_event = np.ones(exposed.size, bool)
    has_image = np.ones(exposed.size, bool)
    some = int(rng.integers(1, 12))
    if kind in ("first missing", "everything"):
        has_image[:some] = False
    if kind in ("last missing", "everything"):
        has_image[-int(rng.integers(1, 12)) :] = False
    if kind in ("random missing", "everything"):
        has_image &= rng.random(exposed.size) > rng.uniform(0.01, 0.2)
    if kind in ("lost pulses", "everything"):
        has_event &= rng.random(exposed.size) > rng.uniform(0.005, 0.06)
    if kind == "log begins late":
        has_event[:some] = False
        has_image[-int(rng.integers(0, 6)) or exposed.size :] = False
    if kind in ("test shots", "everything"):  # on the ground, minutes before, by hand
        shots = np.sort(exposed[0] - rng.uniform(60.0, 900.0, some))
        # The operator deletes these images, or not; with them a flight is not constant any more.
        keeps = not constant and rng.random() < 0.5
        exposed = np.concatenate([shots, exposed])
        has_event = np.concatenate([np.ones(some, bool), has_event])
        has_image = np.concatenate([np.full(some, keeps), has_image])
    if kind == "two cameras":  # one channel has the pulses of both, each with its own rhythm
        other = _exposures(rng, constant)
        owner = np.concatenate([np.ones(exposed.size, bool), np.zeros(other.size, bool)])
        order = np.argsort(np.concatenate([exposed, other]), kind="stable")
        exposed = np.concatenate([exposed, other])[order]
        has_image = owner[order] & (rng.random(exposed.size) > 0.03)
        has_event = np.ones(exposed.size, bool)
    event_s = exposed[has_event] + rng.normal(0.0, 0.002, int(has_event.sum()))
    event_s = np.maximum.accumulate(event_s)
    row = np.where(has_event, np.cumsum(has_event) - 1, -1)
    bounced = np.empty(0, int)
    if kind in ("doubled", "everything"):
        twice = np.flatnonzero(rng.random(event_s.size) < rng.uniform(0.005, 0.08))
        again = event_s[twice] + rng.uniform(0.0, 0.15, twice.size)
        event_s = np.concatenate([event_s, again])
        order = np.argsort(event_s, kind="stable")
        place = np.argsort(order)
        row = np.where(row >= 0, place[row], -1)
        bounced = place[event_s.size - twice.size :]
        event_s = event_s[order]
    truth = row[has_image]
    drift = rng.uniform(-1e-4, 1e-4)
    clock = exposed[has_image] * (1.0 + drift) + rng.uniform(-12.0, 12.0) * 3600.0
    milliseconds = bool(rng.random() < 0.5)
    clock += rng.normal(0.0, 0.02, clock.size)
    step = 0.001 if milliseconds else 1.0
    first = int(rng.choice([0, 1, 65_500, int(rng.integers(0, 60_000))]))
    return Drawn(
        kind,
        constant,
        milliseconds,
        event_s,
        (first + np.arange(event_s.size)) % 65_536,
        np.floor(clock / step) * step,
        1 + np.flatnonzero(has_image),
        truth,
        bounced,
    )


def _exposures(rng: np.random.Generator, constant: bool) -> np.ndarray:
    """Times of exposures: 2 to 5 s apart along lines of a survey, 20 to 60 s from line to line."""
    interval = rng.uniform(2.0, 5.0)
    if constant:
        return 1000.0 + interval * np.arange(int(rng.integers(30, 200)))
    lines = int(rng.integers(2, 9))
    wind = rng.uniform(0.01, 0.03)
    each = int(rng.integers(12, 40))
    times = [np.array([1000.0])]
    for line in range(lines):
        along = interval * (1.0 + (-1.0) ** line * rng.uniform(0.0, 0.1))  # head or tail wind
        steps = along * (1.0 + rng.normal(0.0, wind, each + int(rng.integers(-2, 3))))
        steps[0] = rng.uniform(20.0, 60.0) if line else steps[0]
        times.append(times[-1][-1] + np.cumsum(steps))
    return np.concatenate(times)
