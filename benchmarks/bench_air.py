"""The air of four hours at ten readings a second: seconds, and how they grow with the readings."""

from __future__ import annotations

import statistics
import time

import numpy as np
from survey import air

from pipeline.atmosphere.air_samples import AirSamples, SensorSamples
from pipeline.atmosphere.climatology import climatology
from pipeline.atmosphere.estimate.solver import estimate

ROWS = 144_000


def flown(rows: int) -> AirSamples:
    """A thermometer, a barometer and a hygrometer going up and down between 200 and 2700 m."""
    rng, truth = np.random.default_rng(1), air()
    seconds = np.arange(rows) * (14_400.0 / rows)
    h = 200.0 + np.abs((seconds / 900.0) % 2.0 - 1.0) * 2500.0
    stamps = np.round(seconds * 1e9).astype(np.int64)
    readings = ((truth.temperature(h), 0.2), (truth.pressure(h), 5.0), (np.full(rows, 0.5), 0.02))
    return AirSamples(
        *(
            SensorSamples(
                stamps, h, value + sigma * rng.normal(size=rows), np.ones(rows, bool), name
            )
            for (value, sigma), name in zip(readings, ("t", "p", "rh"), strict=True)
        )
    )


def test_four_hours_at_ten_hertz():
    background = climatology(latitude_rad=0.8, month=7.0)
    taken = {}
    for rows in (ROWS // 4, ROWS):
        samples, times = flown(rows), []
        for _ in range(7):
            start = time.perf_counter()
            estimate(samples, background)
            times.append(time.perf_counter() - start)
        taken[rows] = statistics.median(times)
    print(", ".join(f"{rows:,} readings a sensor: {t:.2f} s" for rows, t in taken.items()))
    assert taken[ROWS] < 2.0
    assert taken[ROWS] < 4.0 * taken[ROWS // 4] + 0.5
