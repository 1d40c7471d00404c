"""Logs that ArduPilot wrote in its own simulator, with their own camera events and truth."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
import pytest

from tests.logs import REAL
from unbend.batch.executors import Outcome

from .conftest import needs_shared, read_observations, run_mission, write_mission

pytestmark = needs_shared

CAMERA = {
    "width_px": 6000,
    "height_px": 4000,
    "f_px": 5000.0,
    "cx_px": 3000.0,
    "cy_px": 2000.0,
    "calibration": "laboratory",
}


def kinds_of(name):
    """The extensions of the logs of a flight that are at hand: BIN and tlog."""
    logs = sorted(REAL.glob(f"{name}.*"))
    return [path.suffix.removeprefix(".") for path in logs]


@dataclass(frozen=True)
class Flown:
    outcome: Outcome
    stations: pd.DataFrame
    profile: pd.DataFrame
    truth: pd.DataFrame

    @property
    def manifest(self):
        return self.outcome.manifest.values

    def entries(self, code, field):
        """A field of the ledger's entries with this code."""
        ledger = self.manifest["ledger"]
        return [entry[field] for entry in ledger if entry["code"] == code]

    @property
    def is_card(self):
        """Whether the log is the autopilot's card, not the telemetry."""
        return self.manifest["log"]["format"] == "dataflash"


@dataclass(frozen=True)
class Flight:
    """A flight of the simulator: its cameras by instance, and the ground [m above sea]."""

    name: str
    cameras: dict[str, int]
    ground_m: float


SURVEY = Flight("sitl_survey", {"cam": 0}, 590.0)
BELOW_SEA = Flight("sitl_belowsea_2cam", {"left": 0, "right": 1}, -428.0)


def fly(folder, flight, extension):
    """Correct points scattered over every image of a simulator log."""
    truth = pd.read_csv(REAL / f"{flight.name}_truth.csv")
    truth = truth[truth["row"] == "CAM"]
    feedback = "CAM" if extension == "BIN" else "CAMERA_FEEDBACK"
    images = []
    events = {}
    for camera, instance in flight.cameras.items():
        indices = truth.loc[truth["I"] == instance, "Img"]
        images += [f"{camera}_{index:05d}" for index in indices]
        events[camera] = {
            "channel": f"{feedback}[{instance}]",
            "image": camera + "_{index:05d}",
        }
    scattered_points(images, seed=3).to_parquet(folder / "observations.parquet")
    path = write_mission(
        folder / "mission.yaml",
        mission={"name": flight.name},
        log={"path": str(REAL / f"{flight.name}.{extension}")},
        observations={"path": "observations.parquet"},
        cameras={camera: dict(CAMERA) for camera in flight.cameras},
        mount={camera: {} for camera in flight.cameras},
        events={"log": events},
        ground={"height": flight.ground_m, "reference": "msl"},
        output={"path": "results"},
    )
    outcome = run_mission(path)
    return Flown(
        outcome,
        stations=pd.read_parquet(outcome.output / "stations.parquet"),
        profile=pd.read_parquet(outcome.output / "profile.parquet"),
        truth=truth,
    )


def scattered_points(images, seed):
    """Five points in each of these images of `CAMERA`."""
    rng = np.random.default_rng(seed)
    count = 5 * len(images)
    return pd.DataFrame(
        {
            "image": np.repeat(images, 5),
            "point": [f"p{i}" for i in range(count)],
            "x_px": rng.uniform(0, 6000, count),
            "y_px": rng.uniform(0, 4000, count),
        }
    )


@pytest.fixture(
    scope="module",
    params=kinds_of(SURVEY.name),
)
def survey(request, tmp_path_factory):
    return fly(tmp_path_factory.mktemp("survey"), SURVEY, request.param)


@pytest.fixture(
    scope="module",
    params=kinds_of(BELOW_SEA.name),
)
def two_cameras(request, tmp_path_factory):
    return fly(tmp_path_factory.mktemp("belowsea"), BELOW_SEA, request.param)


def test_every_event_has_a_station(survey):
    assert (survey.stations["status"] == "ok").all()
    assert len(survey.stations) == 256


def standard_icao(h_m):
    """ICAO standard from its definition (ISO 2533), troposphere."""
    geopotential = 6_356_766.0 * h_m / (6_356_766.0 + h_m)
    temperature = 288.15 - 0.0065 * geopotential
    pressure = 1013.25 * (temperature / 288.15) ** (9.80665 * 28.96442 / 8314.32 / 0.0065)
    return temperature, pressure


def assert_profile_is_standard(flown, rms_k, most_hpa):
    measured = flown.profile[flown.profile["source"] == "measured"]
    assert len(measured) > 10
    temperature, pressure = standard_icao(measured["h_m"].to_numpy())
    # The simulator's air is dry: what vapour the climatology puts in, T_M has to carry.
    share = measured["vapour_pressure_pa"] / measured["pressure_pa"]
    dry = measured["temperature_k"] / (1.0 - 0.378 * share)
    # What is left is that vapour, largest at the ground: 0.9 K of virtual temperature, of which the
    # measured temperatures give half back, 0.43 K (.BIN) and 0.50 K (.tlog) or 1.3 sigmas there.
    # Fixes stamped at their epoch moved it from 0.49 and 0.47, by the vapour alone: pressures at
    # the ground went from 4 to 1 Pa off (.BIN) and stayed at 2 Pa (.tlog).
    error_k = dry - temperature
    assert (np.abs(error_k) < 2.0 * measured["sigma_temperature_k"]).all()
    assert np.sqrt(np.mean(error_k**2)) < rms_k
    assert np.abs(measured["temperature_k"] - temperature).max() < 2.5
    assert np.abs(measured["pressure_pa"] / 100.0 - pressure).max() < most_hpa
    assert flown.manifest["channels"]["temperature"] in (
        "ARSP[0]",
        "SCALED_PRESSURE.temperature_press_diff",
    )


def test_profile_is_the_air_and_not_the_board(survey):
    assert_profile_is_standard(survey, rms_k=0.4, most_hpa=0.5)


def test_profile_below_the_sea_is_the_air_and_not_the_board(two_cameras):
    # The standard is 10 K colder than the usual air over the Dead Sea: there a thermometer that is
    # good to 3 K, and sampled over 700 m, is taken for 2 K too cold. Sigmas are 1.7 K.
    assert_profile_is_standard(two_cameras, rms_k=2.5, most_hpa=1.0)


def test_sound_flights_raise_no_finding(survey, two_cameras):
    for flown in (survey, two_cameras):
        findings = set()
        for entry in flown.manifest["ledger"]:
            if entry["kind"] == "finding":
                findings.add(entry["code"])
        assert findings <= {"LOG-DROPOUT"}  # the logger's own count, on a card
        assert flown.is_card or not findings


def test_two_cameras_stay_apart_and_lost_pulses_are_counted(two_cameras):
    count = two_cameras.stations["camera"].value_counts()
    assert count.to_dict() == {"left": 127, "right": 128}
    assert two_cameras.stations["image"].is_unique
    # The right camera has no feedback pin (CAM2_FEEDBAK_PIN -1): 128 triggers are 128 images.
    images = two_cameras.truth.loc[two_cameras.truth["I"] == 1, "Img"]
    assert sorted(images) == list(range(1, 129))
    feedback = "CAM" if two_cameras.is_card else "CAMERA_FEEDBACK"
    assert set(two_cameras.entries("EVENTS-LOST", "where")) == {f"{feedback}[0]"}
    assert set(two_cameras.entries("EVENTS-TRIGGER-TIME", "where")) == {f"{feedback}[1]"}
    if two_cameras.is_card:
        # 142 triggers and 127 pulses of the left one
        assert 142 - 127 in two_cameras.entries("EVENTS-LOST", "count")
    else:
        assert sum(two_cameras.entries("EVENT-REPEAT", "count")) == 254
        assert two_cameras.entries("EVENT-EMPTY", "count")[0] == 1


def test_observations_are_corrected(survey):
    observations = read_observations(survey.outcome.output)
    assert (observations["status"] == "ok").all()
    dropped = survey.entries("LOG-DROPOUT", "count")
    if survey.is_card:
        assert dropped == [3]  # DSF.Dp of the log at its end
        assert survey.outcome.exit_code == 3
    else:
        assert dropped == []
        assert survey.outcome.exit_code == 0
    h_msl_m = survey.stations.set_index("image")["h_msl_m"]
    above_m = h_msl_m[observations["image"]].to_numpy() - SURVEY.ground_m
    shift_px = np.hypot(
        observations["x_corrected_px"] - observations["x_px"],
        observations["y_corrected_px"] - observations["y_px"],
    )
    # R = K tan(zeta), K about 11.5 urad a kilometre above ground, seen with f = 5000 px.
    rough_px = 5000.0 * 11.5e-9 * above_m * np.tan(observations["zeta_c_rad"])
    assert np.all(shift_px < 3.0 * rough_px + 1e-4)
    assert np.all(shift_px > 0.5 * rough_px - 1e-4)
