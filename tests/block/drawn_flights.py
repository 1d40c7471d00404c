"""Flights drawn at random with the true assignment of their events to images.

Independent of the package: times of exposures by distance along lines with wind, turns between the
lines, what gets lost, repeated or fired on the ground, and the camera's clock.
"""

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

    event_s: np.ndarray
    image_s: np.ndarray  # by the camera's clock
    sigma_s: float  # of the images' times, in milliseconds or whole seconds
    truth: np.ndarray  # row of the event of each image, -1 where its pulse was lost


def draw(
    rng,
    kind,
    *,
    constant=False,
):
    """A flight of a kind, with intervals that are ``constant``, or with wind and turns."""
    everything = kind == "everything"
    exposed = exposures(rng, constant)
    has_event = np.ones(exposed.size, bool)
    has_image = np.ones(exposed.size, bool)
    several = rng.integers(1, 12)
    if everything or kind == "first missing":
        has_image[:several] = False
    if everything or kind == "last missing":
        has_image[-rng.integers(1, 12) :] = False
    if everything or kind == "random missing":
        has_image &= rng.random(exposed.size) > rng.uniform(0.01, 0.2)
    if everything or kind == "lost pulses":
        has_event &= rng.random(exposed.size) > rng.uniform(0.005, 0.06)
    if kind == "log begins late":
        has_event[:several] = False
        has_image[exposed.size - rng.integers(0, 6) :] = False
    if everything or kind == "test shots":  # on the ground, minutes before, by hand
        shots = np.sort(exposed[0] - rng.uniform(60.0, 900.0, several))
        # The operator deletes these images, or not; with them a flight is not constant any more.
        keeps = not constant and rng.random() < 0.5
        exposed = np.append(shots, exposed)
        has_event = np.append(np.ones(several, bool), has_event)
        has_image = np.append(np.full(several, keeps), has_image)
    if kind == "two cameras":  # one channel has the pulses of both, each with its own rhythm
        other = exposures(rng, constant)
        is_of_camera = np.repeat([True, False], [exposed.size, other.size])
        exposed = np.append(exposed, other)
        order = np.argsort(exposed, kind="stable")
        exposed = exposed[order]
        has_image = is_of_camera[order] & (rng.random(exposed.size) > 0.03)
        has_event = np.ones(exposed.size, bool)
    pulse_s = exposed[has_event]
    jitter_s = rng.normal(0.0, 0.002, pulse_s.size)
    event_s = np.maximum.accumulate(pulse_s + jitter_s)
    row = np.where(has_event, np.cumsum(has_event) - 1, -1)
    if everything or kind == "doubled":
        is_twice = rng.random(event_s.size) < rng.uniform(0.005, 0.08)
        again_s = event_s[is_twice] + rng.uniform(0.0, 0.15, np.count_nonzero(is_twice))
        event_s = np.append(event_s, again_s)
        order = np.argsort(event_s, kind="stable")
        event_s = event_s[order]
        place = np.argsort(order)
        row = np.where(row >= 0, place[row], -1)
    drift = 1.0 + rng.uniform(-1e-4, 1e-4)
    clock_s = exposed[has_image] * drift + rng.uniform(-12.0, 12.0) * 3600.0
    step_s = 1.0
    sigma_s = 12.0**-0.5
    if rng.random() < 0.5:
        step_s = 0.001
        sigma_s = 0.02
    clock_s += rng.normal(0.0, 0.02, clock_s.size)
    return Drawn(
        event_s,
        np.floor(clock_s / step_s) * step_s,
        sigma_s,
        row[has_image],
    )


def exposures(rng, constant):
    """Times of exposures: 2 to 5 s apart along lines of a survey, 20 to 60 s from line to line."""
    interval = rng.uniform(2.0, 5.0)
    if constant:
        return 1000.0 + interval * np.arange(rng.integers(30, 200))
    lines = rng.integers(2, 9)
    wind = rng.uniform(0.01, 0.03)
    each = rng.integers(12, 40)
    steps = [np.array([1000.0])]
    for line in range(lines):
        along = interval * (1.0 + (-1.0) ** line * rng.uniform(0.0, 0.1))  # head or tail wind
        count = each + rng.integers(-2, 3)
        steps.append(along * (1.0 + rng.normal(0.0, wind, count)))
        if line:
            steps[-1][0] = rng.uniform(20.0, 60.0)
    return np.cumsum(np.concatenate(steps))
