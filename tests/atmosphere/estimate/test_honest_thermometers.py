"""Thermometers that work are used, and on low climbs their estimate knows its error.

Flights drawn through nine soundings and five extreme airs, a third of them over hot ground with the
sun on the probe. UNBEND_THERMOMETERS draws (`make faults`: 1600; 24 in `make test`) with seed
UNBEND_SEED; truth is integrated and sensors are simulated in `flights`.
"""

from __future__ import annotations

import math
import os

import numpy as np
import pytest
from scipy.stats import chi2

from tests.draws import SEED
from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.climatology import climatology, month_of
from unbend.atmosphere.estimate.adjusted_profile import build_adjusted_profile
from unbend.messages import Kind, Ledger

US1976 = standard_atmosphere("us1976")
DRAWS = int(os.environ.get("UNBEND_THERMOMETERS", "24"))


@pytest.fixture(scope="module")
def airs(flights):
    return [flights.Truth(balloon) for balloon in (*flights.balloons(), *flights.extremes())]


def flown(flights, truth, climb, rng, *, sunny, **how):
    """Error of R in sigmas, the adjustment, and the codes of what was lost."""
    truth = truth.over_hot_ground(rng) if sunny else truth
    samples = flights.fly(truth, climb, flights.drawn(rng), rng, **how)
    samples = flights.sun_on_the_probe(samples, rng) if sunny else samples
    air = climatology(
        latitude_rad=truth.latitude, month=month_of(truth.start_ns), ground_h_m=float(truth.h[0])
    )
    ledger = Ledger()
    found = build_adjusted_profile(
        samples, US1976, truth.latitude, ledger, background=air, time_ns=truth.start_ns
    )
    sigma = found.covariance.relative_sigma(truth.h[0] + climb, truth.h[0])
    lost = [f"{entry.code} {entry.what}" for entry in ledger if entry.kind is Kind.LOSS]
    return truth.error(found.profile, climb) / sigma, found, lost


def test_thermometers_that_work_are_not_refused(flights, airs):
    """At most one of 500 between 0.4 and 3 km, and then R within its sigma.

    Climbs of 2 to 6 m/s, half of them with the descent; readings from 20, 60 or 120 s after
    take-off; humidity of the whole flight, of the ground, or none.
    """
    rng = np.random.default_rng(SEED)
    refused = []
    for i in range(DRAWS):
        truth = airs[int(rng.integers(len(airs)))]
        climb = round(400.0 * math.exp(rng.uniform(0.0, math.log(7.5))))
        how = {
            "rate": rng.uniform(2.0, 6.0),
            "descent": bool(rng.random() < 0.5),
            "gate_s": float(rng.choice([20.0, 60.0, 120.0])),
            "humidity": str(rng.choice(["none", "surface", "profile"])),
        }
        error, _, lost = flown(flights, truth, climb, rng, sunny=rng.random() < 0.3, **how)
        if lost:
            refused.append((i, truth.name, climb, round(error, 1), lost))
    print(f"seed {SEED}: {len(refused)} of {DRAWS} refused: {refused}")
    # Reached: none of 1,600. Of so few, two or more of 24 are refused on one day in ten thousand.
    assert len(refused) <= max(1.0, DRAWS / 500)
    assert all(abs(error) < 1.0 for _, _, _, error, _ in refused)


WAYS = {
    "climb": {"gate_s": 20.0, "rate": 3.0},
    "up and down": {"gate_s": 30.0, "descent": True},
    "up and down, two minutes after take-off": {"gate_s": 120.0, "rate": 3.0, "descent": True},
}
LOW = max(1, DRAWS // 200)


@pytest.mark.parametrize("sunny", [False, True])
def test_low_climbs_with_a_thermometer_are_honest(flights, airs, sunny):
    """Climbs of 300 to 600 m: error over sigma with an RMS of 0.7 to 1.2, in each way of flying.

    Reached: 0.95, and 1.17 over hot ground with the sun on the probe.

    24 flights in `make test`, 1344 in `make faults`.
    """
    rng = np.random.default_rng([SEED, 1])
    every = 7 if LOW == 1 else 1  # of the airs
    found = {name: [] for name in WAYS}
    for climb in (300.0, 400.0, 500.0, 600.0):
        for truth in airs[round(climb / 100.0) % every :: every]:
            for name, how in WAYS.items():
                for _ in range(LOW):
                    error, _, _ = flown(
                        flights, truth, climb, rng, sunny=sunny, humidity="none", **how
                    )
                    found[name].append(error)
    rms = {name: float(np.sqrt(np.mean(np.square(errors)))) for name, errors in found.items()}
    every_error = np.concatenate(list(found.values()))
    total = float(np.sqrt(np.mean(every_error**2)))
    print(f"seed {SEED}: {total:.2f} of {every_error.size} flights, {rms}")
    low = 0.7
    high = 1.2
    if LOW == 1:
        # Of a few errors: the RMS that all reach, within chi-square's share of all but 1e-4.
        reached = 1.17 if sunny else 0.95
        freedom = every_error.size
        low, high = reached * np.sqrt(chi2.ppf([5e-5, 1.0 - 5e-5], freedom) / freedom)
    assert low <= total <= high
    if LOW > 1:
        assert all(0.65 <= value <= (1.4 if sunny else 1.3) for value in rms.values()), rms
