"""The air of four hours at ten readings a second: its time, and how it grows with the readings."""

from __future__ import annotations

import numpy as np
from survey import air

from unbend.atmosphere.air_samples import AirSamples, SensorSamples
from unbend.atmosphere.climatology import climatology
from unbend.atmosphere.estimate.solver import estimate

ROWS = 144_000


def flown(rows: int) -> AirSamples:
    """A thermometer, a barometer and a hygrometer going up and down between 200 and 2700 m."""
    rng = np.random.default_rng(1)
    truth = air()
    seconds = np.arange(rows) * (14_400.0 / rows)
    h = 200.0 + np.abs((seconds / 900.0) % 2.0 - 1.0) * 2500.0
    stamps = np.round(seconds * 1e9).astype(np.int64)
    readings = ((truth.temperature(h), 0.2), (truth.pressure(h), 5.0), (np.full(rows, 0.5), 0.02))
    return AirSamples(
        *(
            SensorSamples(
                stamps, h, value + sigma * rng.normal(size=rows), np.zeros(rows, np.uint8), name
            )
            for (value, sigma), name in zip(readings, ("t", "p", "rh"), strict=True)
        )
    )


def test_four_hours_at_ten_hertz(ratios):
    """Beside sorting the same readings, and beside a quarter of them.

    Each estimate goes several times over the readings and solves systems of some hundred unknowns,
    whose number does not depend on that of the readings.
    """
    background = climatology(latitude_rad=0.8, month=7.0)
    samples = flown(ROWS)
    quarter = flown(ROWS // 4)
    columns = [samples.temperature.value, samples.pressure.value, samples.humidity.value]

    def sort() -> None:
        for column in columns:
            np.sort(column)

    growth = 1.0 / ratios.of_times(
        lambda: estimate(samples, background), lambda: estimate(quarter, background)
    )
    cost = 1.0 / ratios.of_times(lambda: estimate(samples, background), sort)
    ratios.check("air of 144,000 readings a sensor, times that of 36,000", growth, at_most=4.0)
    ratios.check("air of 144,000 readings a sensor, times sorting them", cost, at_most=50.0)
