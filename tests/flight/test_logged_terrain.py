"""Terrain heights of the autopilot: from both kinds of logs, and beside given heights."""

import numpy as np
import pytest

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


COLUMNS = {"TERR": "TerrH", "TERRAIN_REPORT": "terrain_height"}


@pytest.mark.parametrize(
    "name",
    at_hand("flight.bin", "beastayyg_sample.bin", "sitl_survey.BIN", "sitl_survey.tlog"),
)
def test_a_log_has_its_terrain_as_its_messages_do(name):
    """Tables of messages are compared with pymavlink in the tests of ingest."""
    log = open_log(LOGS[name])
    terrain = [logged for logged in log.channels if logged.name in COLUMNS]
    assert len(terrain) == len(COLUMNS.keys() & log.messages.keys())
    for logged in terrain:
        assert not logged.roles
        heights_m = log.message(logged.name)[COLUMNS[logged.name]]
        np.testing.assert_array_equal(logged["h_terrain_m"], heights_m)
