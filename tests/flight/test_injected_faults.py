"""Faults drawn into good logs with known truth: no usable station is far off, few good are lost.

Truth is the simulator's (`*_truth.csv`), at every exposure. The faults are those of
`injected_faults`; each is seen by a second channel. 104 are drawn; with UNBEND_FLIGHTS of 208 or
more, as in `make faults`, 208.
"""

from __future__ import annotations

import os
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.draws import SEED
from tests.flight.injected_faults import KINDS, inject
from tests.flight.made_channels import EARTH_M, rotation_of
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
DRAWS = 208 if int(os.environ.get("UNBEND_FLIGHTS", "0")) >= 208 else 104

pytestmark = pytest.mark.shared("logs")


@dataclass(frozen=True)
class Flown:
    """The channels of a log, and the truth at each exposure, in the order of time."""

    channels: dict[str, Channel]
    truth: pd.DataFrame

    @property
    def time_ns(self) -> np.ndarray:
        return self.truth["time_ns"].to_numpy()


def flown(name: str) -> Flown:
    channels = {channel.name: channel for channel in open_log(LOGS / f"{name}.BIN").channels}
    rows = pd.read_csv(LOGS / f"{name}_truth.csv")
    rows = rows[rows["row"] == "CAM"].set_index(["I", "Img"])
    parts = []
    for channel in channels.values():
        if channel.source.message == "CAM":
            camera = int(channel.source.instance)
            exposed = [(camera, int(index)) for index in channel["event_index"]]
            parts.append(rows.loc[exposed].assign(time_ns=channel.time_ns))
    return Flown(channels, pd.concat(parts).sort_values("time_ns"))


@pytest.fixture(scope="module")
def logs() -> list[Flown]:
    return [flown("sitl_survey"), flown("sitl_belowsea_2cam")]


def stations_of(channels: dict[str, Channel], time_ns: np.ndarray) -> tuple[Stations, Counter]:
    """The stations as a run builds them, and how many exposures each code of the ledger counts."""
    everything = tuple(channels.values())
    roles, _ = assign_roles(everything, {}, needs_cabin=False)
    plausible = {role: plausible_samples(channel, role)[0] for role, channel in roles.items()}
    examined, suspect, _ = examine(everything, plausible)
    heights, _ = height_system(examined, None)
    roles, accuracy = with_accuracy(examined, everything)
    events = Events("cam", np.full(time_ns.size, "", object), time_ns)
    stations = build_stations(events, roles, Mount(), heights, 2.0, accuracy=accuracy)
    flagged, notes = flag_suspect(stations, suspect, use_suspect=False)
    return flagged, Counter({note.code: note.count for note in notes})


def errors_of(stations: Stations, truth: pd.DataFrame) -> dict[str, np.ndarray]:
    """(n, 2) metres north and east, (n, 1) up, and (n, 2) degrees that the vertical is turned."""
    lat, lon, roll, pitch = np.radians(truth[["lat", "lng", "roll", "pitch"]]).to_numpy().T
    north_m = (stations.lat_rad - lat) * EARTH_M
    east_m = (stations.lon_rad - lon) * EARTH_M * np.cos(lat)
    down = [-np.sin(pitch), np.cos(pitch) * np.sin(roll), np.cos(pitch) * np.cos(roll)]
    body_from_enu = rotation_of(np.nan_to_num(stations.aircraft_quaternion, nan=0.5))
    turned = np.cross(body_from_enu.apply([0.0, 0.0, -1.0]), np.stack(down, axis=1))
    return {
        "horizontal": np.stack([north_m, east_m], axis=1),
        "height": (stations.h_msl_m - truth["alt_amsl"].to_numpy())[:, None],
        "tilt": np.degrees(turned[:, :2]),
    }


def too_far(errors: dict[str, np.ndarray]) -> np.ndarray:
    """Where a station is beyond 5 m or 1 degree of the optical axis."""
    limits = {"horizontal": 5.0, "height": 5.0, "tilt": 1.0}
    beyond = [np.linalg.norm(errors[name], axis=1) > limit for name, limit in limits.items()]
    return np.any(beyond, axis=0)


def beyond_four_sigmas(stations: Stations, errors: dict[str, np.ndarray]) -> np.ndarray:
    sigmas = {
        "horizontal": stations.sigma_horizontal_m,
        "height": stations.sigma_height_m,
        "tilt": np.degrees(stations.sigma_tilt_rad),
    }
    beyond = []
    for name, sigma in sigmas.items():
        assert np.isfinite(sigma[stations.ok]).all()
        beyond.append((np.abs(errors[name]) > 4.0 * sigma[:, None]).any(axis=1))
    return np.any(beyond, axis=0)


def test_good_logs_have_no_suspect(logs):
    for log in logs:
        stations, codes = stations_of(log.channels, log.time_ns)
        errors = errors_of(stations, log.truth)
        assert stations.ok.all()
        assert not codes
        assert not too_far(errors).any()
        assert not beyond_four_sigmas(stations, errors).any()


def test_no_usable_station_is_far_off_and_few_good_ones_are_lost(logs):
    print(f"seed {SEED}: {DRAWS} faults")
    rng = np.random.default_rng(SEED)
    counts: Counter[str] = Counter()
    failures = []
    for number in range(DRAWS):
        log = logs[number % 2]
        kind = KINDS[(number // 2) % len(KINDS)]
        channels, fault = inject(log.channels, kind, int(rng.choice(log.time_ns)), rng)
        stations, codes = stations_of(channels, log.time_ns)
        errors = errors_of(stations, log.truth)
        far = too_far(errors)
        wrong = stations.ok & (far | beyond_four_sigmas(stations, errors))
        good = ~fault.holds(log.time_ns) & ~far
        counts["far"] += far.sum()
        counts["good"] += good.sum()
        counts["good but suspect"] += (good & ~stations.ok).sum()
        counts["replaced"] += codes["STATIONS-STAND-IN"]
        if wrong.any():
            failures.append(f"draw {number}: {fault}: {wrong.sum()} stations")
    print(dict(counts))
    assert not failures, "\n".join(failures)
    assert counts["far"] > 1.5 * DRAWS  # the faults do harm
    assert counts["replaced"] > 1.5 * DRAWS  # and good sources stand in
    assert counts["good but suspect"] <= 0.01 * counts["good"], counts
