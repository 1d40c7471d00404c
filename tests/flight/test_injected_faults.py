"""Faults drawn into good logs with known truth: no usable station is far off, few good are lost.

Truth is the simulator's, at every exposure. The faults are those of `injected_faults`; each is seen
by a second channel. 104 are drawn; with UNBEND_FLIGHTS of 208 or more, as in `make faults`, 208.
"""

import os
from collections import Counter

import numpy as np
import pytest

from tests.draws import SEED
from tests.flight.injected_faults import KINDS, inject
from tests.flight.made_channels import plausible_roles
from tests.flight.simulator_logs import (
    errors,
    flight,
    sigmas,
    unnamed_events,
)
from unbend.flight.evidence.contradictions import examine
from unbend.flight.evidence.log_accuracy import with_accuracy
from unbend.flight.evidence.stretches import flag_suspect
from unbend.flight.heights import height_system
from unbend.flight.mount import Mount
from unbend.flight.station_builder import build_stations

DRAWS = 208 if int(os.environ.get("UNBEND_FLIGHTS", "0")) >= 208 else 104
FAR = {"horizontal": 5.0, "height": 5.0, "tilt": 1.0}  # [m], and degrees of the optical axis

pytestmark = pytest.mark.shared("logs")


@pytest.fixture(scope="module")
def logs():
    return [flight("sitl_survey"), flight("sitl_belowsea_2cam")]


def stations_of(channels, time_ns):
    """The stations as a run builds them, and how many exposures each code of the ledger counts."""
    examined, suspect, _ = examine(channels, plausible_roles(channels))
    heights, _ = height_system(examined, None)
    roles, accuracy = with_accuracy(examined, channels)
    stations = build_stations(
        unnamed_events(time_ns),
        roles,
        Mount(),
        heights,
        2.0,
        accuracy=accuracy,
    )
    flagged, notes = flag_suspect(stations, suspect, use_suspect=False)
    return flagged, Counter({note.code: note.count for note in notes})


def too_far(error):
    """(n,) which stations are far from the truth."""
    is_far = False
    for name, limit in FAR.items():
        is_far |= np.linalg.norm(error[name], axis=1) > limit
    return is_far


def beyond_four_sigmas(stations, error):
    """(n,) which stations are farther from the truth than they say."""
    sigma = sigmas(stations)
    is_beyond = False
    for name in FAR:
        assert np.isfinite(sigma[name][stations.ok]).all()
        is_beyond |= (np.abs(error[name]) > 4.0 * sigma[name]).any(axis=1)
    return is_beyond


def test_good_logs_have_no_suspect(logs):
    for log in logs:
        stations, codes = stations_of(log.log.channels, log.time_ns)
        error = errors(stations, log.truth)
        assert stations.ok.all()
        assert not codes
        assert not too_far(error).any()
        assert not beyond_four_sigmas(stations, error).any()


def test_no_usable_station_is_far_off_and_few_good_ones_are_lost(logs):
    print(f"seed {SEED}: {DRAWS} faults")
    rng = np.random.default_rng(SEED)
    counts = Counter()
    failures = []
    for number in range(DRAWS):
        log = logs[number % 2]
        kind = KINDS[(number // 2) % len(KINDS)]
        good = {channel.name: channel for channel in log.log.channels}
        around_ns = int(rng.choice(log.time_ns))
        channels, fault = inject(good, kind, around_ns, rng)
        stations, codes = stations_of(tuple(channels.values()), log.time_ns)
        error = errors(stations, log.truth)
        is_far = too_far(error)
        is_good = ~fault.holds(log.time_ns) & ~is_far
        counts["far"] += is_far.sum()
        counts["good"] += is_good.sum()
        counts["good but suspect"] += (is_good & ~stations.ok).sum()
        counts["replaced"] += codes["STATIONS-STAND-IN"]
        is_wrong = stations.ok & (is_far | beyond_four_sigmas(stations, error))
        if is_wrong.any():
            failures.append(f"draw {number}: {fault}: {is_wrong.sum()} stations")
    print(dict(counts))
    assert not failures, "\n".join(failures)
    assert counts["far"] > 1.5 * DRAWS  # the faults do harm
    assert counts["replaced"] > 1.5 * DRAWS  # and good sources stand in
    assert counts["good but suspect"] <= 0.01 * counts["good"], counts
