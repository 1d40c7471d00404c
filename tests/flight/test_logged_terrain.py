"""Terrain heights of the autopilot: from both kinds of logs, and beside given heights."""

from __future__ import annotations

import numpy as np
import pytest
from pymavlink import mavutil

from tests.logs import LOGS, at_hand
from unbend.flight.channels import Channel, Source
from unbend.flight.heights import logged_terrain
from unbend.ingest import open_log

SECOND = 1_000_000_000


def channel(**columns):
    n = len(next(iter(columns.values())))
    values = {name: np.asarray(column, float) for name, column in columns.items()}
    return Channel("TERR", np.arange(n) * SECOND, values, Source("TERR"))


def test_only_heights_of_a_healthy_grid_count():
    times = np.array([500_000_000, 1_500_000_000, 2_500_000_000])
    of_log = channel(h_terrain_m=[100.0, 110.0, 0.0, 0.0], terrain_status=[2, 2, 1, 1])
    assert logged_terrain([of_log], times)[0] == 105.0
    assert np.isnan(logged_terrain([of_log], times)[1:]).all()
    of_telemetry = channel(
        h_terrain_m=[100.0, 110.0, 120.0, 0.0], terrain_spacing_m=[100, 100, 100, 0]
    )
    assert logged_terrain([of_telemetry], times)[:2].tolist() == [105.0, 115.0]
    of_nowhere = channel(h_terrain_m=[0.0, 0.0], terrain_spacing_m=[100, 100], lat_rad=[0.0, 0.0])
    assert np.isnan(logged_terrain([of_nowhere], times)).all()
    assert np.isnan(logged_terrain([channel(h_msl_m=[1.0, 2.0])], times)).all()


@pytest.mark.parametrize(
    "name", at_hand("flight.bin", "beastayyg_sample.bin", "sitl_survey.BIN", "sitl_survey.tlog")
)
def test_a_log_has_its_terrain_as_pymavlink_reads_it(name):
    path = LOGS[name]
    kind = ["TERR"]
    height = "TerrH"
    if name.endswith("tlog"):
        kind = ["TERRAIN_REPORT"]
        height = "terrain_height"
    reader = mavutil.mavlink_connection(str(path))
    truth = []
    while (message := reader.recv_match(type=kind)) is not None:
        truth.append(getattr(message, height))
    reader.close()
    found = [c for c in open_log(path).channels if c.name in kind]
    assert len(found) == (1 if truth else 0)
    for terrain in found:
        assert not terrain.roles
        np.testing.assert_array_equal(terrain["h_terrain_m"], np.array(truth))
