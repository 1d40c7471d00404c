"""Faults drawn into good logs with known truth: no usable station is far off, few good are lost.

Truth is the simulator's (`*_truth.csv`), at every exposure. The faults are those of
`injected_faults`; each is seen by a second channel. 104 are drawn; with UNBEND_FLIGHTS of 208 or
more, as in `make faults`, 208.
"""

from __future__ import annotations

import csv
import os
import sys
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).parent))

from injected_faults import KINDS, inject

from tests.draws import SEED
from unbend.flight.channels import Channel
from unbend.flight.evidence.contradictions import examine
from unbend.flight.evidence.log_accuracy import with_accuracy
from unbend.flight.evidence.quality import plausible_samples
from unbend.flight.evidence.stretches import flag_suspect
from unbend.flight.exposures import Events
from unbend.flight.heights import height_system
from unbend.flight.mount import Mount
from unbend.flight.roles import assign_roles
from unbend.flight.station_builder import build_stations
from unbend.flight.stations import Stations
from unbend.ingest import open_log

LOGS = Path(__file__).resolve().parents[3] / "shared" / "logs"
RADIUS_M = 6_371_000.0
DRAWS = 208 if int(os.environ.get("UNBEND_FLIGHTS", "0")) >= 208 else 104

pytestmark = pytest.mark.shared("logs")


@dataclass(frozen=True)
class Flown:
    """The channels of a log, and at each exposure time and truth: degrees, metres, radians."""

    channels: dict[str, Channel]
    time_ns: np.ndarray
    lat: np.ndarray
    lon: np.ndarray
    h: np.ndarray
    down: np.ndarray


def flown(name: str) -> Flown:
    channels = {c.name: c for c in open_log(LOGS / f"{name}.BIN").channels}
    with (LOGS / f"{name}_truth.csv").open() as stream:
        truth = {(r["I"], int(r["Img"])): r for r in csv.DictReader(stream) if r["row"] == "CAM"}
    shots = sorted(
        (int(time), truth[c.source.instance, int(index)])
        for c in channels.values()
        if c.source.message == "CAM"
        for time, index in zip(c.time_ns, c["event_index"], strict=True)
    )
    columns = {
        key: np.array([float(row[key]) for _, row in shots])
        for key in ("lat", "lng", "alt_amsl", "roll", "pitch")
    }
    roll = np.radians(columns["roll"])
    pitch = np.radians(columns["pitch"])
    down = [-np.sin(pitch), np.cos(pitch) * np.sin(roll), np.cos(pitch) * np.cos(roll)]
    return Flown(
        channels,
        np.array([time for time, _ in shots]),
        np.radians(columns["lat"]),
        np.radians(columns["lng"]),
        columns["alt_amsl"],
        np.stack(down, axis=1),
    )


@pytest.fixture(scope="module")
def logs() -> list[Flown]:
    return [flown("sitl_survey"), flown("sitl_belowsea_2cam")]


def stations_of(channels: dict[str, Channel], time_ns: np.ndarray) -> tuple[Stations, Counter]:
    """The stations as a run builds them, and how many exposures each code of the ledger counts."""
    everything = tuple(channels.values())
    roles, _ = assign_roles(everything, {}, needs_cabin=False)
    plausible = {role: plausible_samples(c, role)[0] for role, c in roles.items()}
    examined, suspect, _ = examine(everything, plausible)
    image = np.array([f"i{k}" for k in range(time_ns.size)], object)
    heights, _ = height_system(examined, None)
    roles, accuracy = with_accuracy(examined, everything)
    exposed = Events("cam", image, time_ns)
    built = build_stations(exposed, roles, Mount(), heights, 2.0, accuracy=accuracy)
    flagged, notes = flag_suspect(built, suspect, use_suspect=False)
    return flagged, Counter({entry.code: entry.count for entry in notes})


def errors_of(stations: Stations, at: Flown) -> dict[str, np.ndarray]:
    """Metres north, east and up, and degrees by which the vertical is turned."""
    body = Rotation.from_quat(np.nan_to_num(stations.aircraft_quaternion[:, [1, 2, 3, 0]], nan=0.5))
    turned = np.degrees(np.cross(-body.apply([0.0, 0.0, 1.0]), at.down))
    return {
        "north": (stations.lat_rad - at.lat) * RADIUS_M,
        "east": (stations.lon_rad - at.lon) * RADIUS_M * np.cos(at.lat),
        "up": stations.h_msl_m - at.h,
        "roll": turned[:, 0],
        "pitch": turned[:, 1],
    }


def too_far(stations: Stations, at: Flown) -> np.ndarray:
    """Where a station is beyond 5 m or 1 degree of the optical axis."""
    off = errors_of(stations, at)
    return (
        (np.hypot(off["north"], off["east"]) > 5.0)
        | (np.abs(off["up"]) > 5.0)
        | (np.hypot(off["roll"], off["pitch"]) > 1.0)
    )


def beyond_four_sigmas(stations: Stations, at: Flown) -> np.ndarray:
    off = errors_of(stations, at)
    tilt = np.degrees(stations.sigma_tilt_rad)
    sigmas = {
        "north": stations.sigma_horizontal_m,
        "east": stations.sigma_horizontal_m,
        "up": stations.sigma_height_m,
        "roll": tilt,
        "pitch": tilt,
    }
    assert all(np.isfinite(sigma[stations.ok]).all() for sigma in sigmas.values())
    return np.any([np.abs(off[name]) > 4.0 * sigma for name, sigma in sigmas.items()], axis=0)


def test_good_logs_have_no_suspect(logs):
    for log in logs:
        stations, codes = stations_of(log.channels, log.time_ns)
        assert stations.ok.all()
        assert not codes
        assert not (too_far(stations, log) | beyond_four_sigmas(stations, log)).any()


def test_no_usable_station_is_far_off_and_few_good_ones_are_lost(logs, record_property):
    print(f"seed {SEED}: {DRAWS} faults")
    rng = np.random.default_rng(SEED)
    counts: Counter[str] = Counter()
    failures = []
    for draw in range(DRAWS):
        log = logs[draw % 2]
        kind = KINDS[(draw // 2) % len(KINDS)]
        channels, fault = inject(log.channels, kind, int(rng.choice(log.time_ns)), rng)
        stations, codes = stations_of(channels, log.time_ns)
        far = too_far(stations, log)
        wild = far | beyond_four_sigmas(stations, log)
        inside = (log.time_ns >= fault.begin_ns) & (log.time_ns <= fault.end_ns)
        good = ~inside & ~far
        counts["far"] += int(far.sum())
        counts["good"] += int(good.sum())
        counts["good but suspect"] += int((good & ~stations.ok).sum())
        counts["replaced"] += codes["STATIONS-STAND-IN"]
        if (wild & stations.ok).any():
            failures.append(f"draw {draw}: {fault}: {int((wild & stations.ok).sum())} stations")
    print(dict(counts))
    assert not failures, "\n".join(failures)
    assert counts["far"] > 1.5 * DRAWS  # the faults do harm
    assert counts["replaced"] > 1.5 * DRAWS  # and good sources stand in
    assert counts["good but suspect"] <= 0.01 * counts["good"], counts
