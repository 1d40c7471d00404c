"""Terrain heights of the autopilot: from both kinds of logs, and beside given heights."""

import numpy as np
import pytest
from pymavlink import mavutil

from tests.flight.made_channels import instants
from tests.helpers import channel
from tests.logs import LOGS, at_hand
from unbend.flight.heights import logged_terrain
from unbend.ingest import open_log

NAN = float("nan")


@pytest.mark.parametrize(
    ("columns", "expected"),
    [
        (
            {
                "h_terrain_m": [100.0, 110.0, 0.0, 0.0],
                "terrain_status": [2, 2, 1, 1],
            },
            [105.0, NAN, NAN],
        ),
        (
            {
                "h_terrain_m": [100.0, 110.0, 120.0, 0.0],
                "terrain_spacing_m": [100, 100, 100, 0],
            },
            [105.0, 115.0, NAN],
        ),
        ({"h_terrain_m": 0.0, "terrain_spacing_m": 100, "lat_rad": 0.0}, [NAN] * 3),
        ({"h_msl_m": 1.0}, [NAN] * 3),
    ],
    ids=["of the log", "of telemetry", "of nowhere", "none"],
)
def test_only_heights_of_a_healthy_grid_count(columns, expected):
    terrain = channel("TERR", np.arange(4), **columns)
    terrain_m = logged_terrain([terrain], instants(0.5, 1.5, 2.5))
    np.testing.assert_array_equal(terrain_m, expected)


DATAFLASH = ("TERR", "TerrH")
TELEMETRY = ("TERRAIN_REPORT", "terrain_height")


@pytest.mark.parametrize(
    "name",
    at_hand("flight.bin", "beastayyg_sample.bin", "sitl_survey.BIN", "sitl_survey.tlog"),
)
def test_a_log_has_its_terrain_as_pymavlink_reads_it(name):
    message, column = TELEMETRY if name.endswith("tlog") else DATAFLASH
    reader = mavutil.mavlink_connection(str(LOGS[name]))
    heights_m = []
    while row := reader.recv_match(type=message):
        heights_m.append(getattr(row, column))
    reader.close()

    channels = [logged for logged in open_log(LOGS[name]).channels if logged.name == message]

    assert len(channels) == bool(heights_m)
    for terrain in channels:
        assert not terrain.roles
        np.testing.assert_array_equal(terrain["h_terrain_m"], heights_m)
