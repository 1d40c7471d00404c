"""Logs of real flights run to the end; their events and measurements are made up here."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.helpers import NS_PER_S
from tests.logs import REAL
from unbend.errors import MissionError
from unbend.ingest import open_log
from unbend.report.summary import remarks, verdict

from .conftest import needs_shared, read_observations, run_mission, write_mission
from .test_autopilot_logs import CAMERA, scattered_points

pytestmark = needs_shared


def fly(
    folder,
    name,
    ground: dict[str, object],
    undulation_m=None,
    **log,
):
    """Exposures every few seconds over the attitude channel, five points in each image."""
    path = REAL / name
    channels = [channel for channel in open_log(path).channels if "attitude" in channel.roles]
    attitude = min(channels, key=lambda channel: channel.rank)
    start = attitude.time_ns[0] + NS_PER_S
    end = attitude.time_ns[-1] - NS_PER_S
    time_ns = np.linspace(start, end, 60).astype(np.int64)
    images = [f"img_{i:03d}" for i in range(60)]
    stamps = pd.to_datetime(time_ns, utc=True).strftime("%Y-%m-%dT%H:%M:%S.%fZ")
    events = pd.DataFrame({"image": images, "time_utc": stamps})
    events.to_csv(folder / "events.csv", index=False)
    points = scattered_points(images, seed=5)
    points.to_csv(folder / "observations.csv", index=False)
    mission = write_mission(
        folder / "mission.yaml",
        mission={"name": Path(name).stem, "undulation_m": undulation_m},
        log={"path": str(path), **log},
        observations={"path": "observations.csv"},
        cameras={"cam": dict(CAMERA)},
        mount={"cam": {}},
        events={"csv": {"path": "events.csv"}},
        ground=ground,
        output={"path": "results"},
    )
    return run_mission(mission)


def checked(outcome):
    """Stations and observations; every row has values or a reason."""
    stations = pd.read_parquet(outcome.output / "stations.parquet")
    observations = read_observations(outcome.output)
    assert len(observations) == 300
    good = observations["status"].isin(["ok", "beyond_grazing"])
    corrected = observations.loc[good, ["x_corrected_px", "y_corrected_px", "r_c_rad"]]
    assert corrected.notna().all(axis=None)
    assert observations.loc[~good, "x_corrected_px"].isna().all()
    usable = stations.loc[stations["status"] == "ok", ["lat_deg", "h_msl_m", "q_w"]]
    assert usable.notna().all(axis=None)
    return stations, observations


def test_copter_with_a_gap_in_the_log(tmp_path):
    ground = {"height": 45.0, "reference": "msl"}
    outcome = fly(tmp_path, "beastayyg_sample.bin", ground)
    stations, observations = checked(outcome)
    # 628 of the 700 s are a gap (disarmed): most exposures must fall into it.
    counts = stations["status"].value_counts()
    assert counts["in_gap"] > 40
    assert counts["ok"] >= 5
    assert outcome.exit_code == 3
    assert outcome.manifest.values["profile"]["basis"] == "climatology"
    corrected = (observations["status"] == "ok").sum()
    assert corrected > 20
    text = verdict(outcome.manifest)
    assert text.startswith(f"{corrected} of 300 observations were corrected by ")
    (air,) = remarks(outcome.manifest)
    assert air.startswith(
        "The air was not measured: a climatology is used instead, the correction is known to ± "
    )
    assert "Ready for bundle adjustment" not in text


def test_telemetry_with_five_boots(tmp_path):
    ground = {"height": 570.0, "reference": "msl"}
    outcome = fly(tmp_path, "pymavlink_swift_flight.tlog", ground)
    stations, observations = checked(outcome)
    assert outcome.manifest.values["log"]["boots"] == 5
    assert (stations["status"] == "ok").sum() > 30
    assert (observations["status"] == "ok").sum() > 100


def test_motion_capture_has_attitude_and_time(tmp_path):
    log = "cubs2_cub_stabilize.mcap"
    origin = {"lat_deg": 40.4, "lon_deg": -86.9, "h_ellipsoid_m": 150.0}
    ground = {"height": 183.0, "reference": "msl"}
    channels = {"position": "/cub1/pose", "attitude": "/cub1/pose"}
    with pytest.raises(MissionError, match="CHANNEL-MISSING"):
        fly(tmp_path, log, ground, channels=channels)

    outcome = fly(tmp_path, log, ground)
    stations, _ = checked(outcome)
    assert (stations["status"] == "no_position").all()
    assert outcome.exit_code == 3

    located = fly(tmp_path, log, ground, local_origin=origin)
    stations, _ = checked(located)
    assert (stations["status"] == "ok").all()  # EGM96 has -34.4 m there
    np.testing.assert_allclose(
        stations["h_ellipsoid_m"] - stations["h_msl_m"],
        -34.4,
        atol=0.1,
    )
    assert stations["q_w"].notna().all()
    assert np.abs(stations["lat_deg"] - 40.4).max() < 0.001

    ground["height"] = 150.0
    whole = fly(
        tmp_path,
        log,
        ground,
        -33.0,
        local_origin=origin,
    )
    stations, observations = checked(whole)
    assert (stations["status"] == "ok").all()
    assert (observations["status"] == "ok").sum() > 50
    # A tenth of the rays of a hand-held model pass over the horizon; nothing else is doubtful.
    findings = {e["code"] for e in whole.manifest.values["ledger"] if e["kind"] == "finding"}
    assert findings <= {"PLAUSIBLE-FLAGGED"}
