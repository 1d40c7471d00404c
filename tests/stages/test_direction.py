"""Whole runs by slant range, and in the other direction."""

import numpy as np
import pyarrow as pa
import pytest
from numpy.testing import assert_allclose

from tests.helpers import codes_of, one_line
from unbend.units import WGS84_A

MEASURED = ["x_px", "y_px"]
CORRECTED = ["x_corrected_px", "y_corrected_px"]
DISPLACED = ["x_displaced_px", "y_displaced_px"]


def pixels(table, columns):
    return table.select(columns).to_pandas()


def read_pixels_from(mission, columns):
    names = dict(zip(MEASURED, columns, strict=True))
    mission.config["observations"]["columns"] = names


def displace(mission):
    """Let the mission apply refraction, which observations that were measured do not need."""
    mission.config["refraction"] = {"direction": "apply"}
    accepted = {"code": "PLAUSIBLE-APPLY", "reason": "there and back"}
    mission.config["accept"] = [accepted]


@pytest.fixture(scope="module")
def corrected(baseline):
    return baseline.results()


@pytest.fixture(scope="module")
def distances(baseline, corrected):
    """Straight distances [m] from the stations to the points of corrected observations."""
    rows = corrected.to_pandas()
    stations = baseline.station_rows().set_index("image")
    zeta = rows["zeta_c_rad"] - rows["r_c_rad"]
    h_c = rows["image"].map(stations["h_msl_m"])
    r_c = WGS84_A + h_c
    r_g = WGS84_A + rows["h_g_m"]
    along = r_c * np.cos(zeta)
    below = r_c**2 - r_g**2
    across = np.sqrt(along**2 - below)
    return below / (along + across)


def assert_heights(table, corrected):
    """The sphere here is that of the equator."""
    assert_allclose(
        table["h_g_m"],
        corrected["h_g_m"],
        rtol=0.0,
        atol=0.01,
    )


def assert_pixels(pixels, expected, tolerance_px):
    assert_allclose(pixels, expected, rtol=0.0, atol=tolerance_px)


def test_what_was_removed_is_applied_again(corrected, mission, obeyed):
    mission.observe(corrected)
    read_pixels_from(mission, CORRECTED)
    displace(mission)
    printed = one_line(obeyed("run", mission.save()))
    assert "All 59 observations were displaced by " in printed
    assert "for simulations and tests: they now contain refraction." in printed
    assert "Ready for bundle adjustment" not in printed
    displaced = mission.results()
    assert displaced.schema.metadata[b"unbend.refraction"] == b"applied"
    assert "x_corrected_px" not in displaced.column_names
    assert displaced.column_names.index("x_displaced_px") == 4
    assert set(displaced["status"].to_pylist()) == {"ok"}
    measured = pixels(corrected, MEASURED)
    ideal = pixels(corrected, CORRECTED)
    assert_pixels(pixels(displaced, DISPLACED), measured, 1e-9)
    assert_pixels(pixels(displaced, MEASURED), ideal, 0.0)
    users = pixels(displaced, ["x_px_input", "y_px_input"])
    assert_pixels(users, measured, 0.0)

    # And removed once more.
    mission.observe(displaced, "again.parquet")
    read_pixels_from(mission, DISPLACED)
    mission.config["refraction"] = {"direction": "remove"}
    mission.run_to_manifest()
    again = pixels(mission.results(), CORRECTED)
    assert_pixels(again, ideal, 1e-9)


def test_heights_from_slant_ranges(corrected, distances, mission):
    ranges = distances.copy()
    ranges[0] = -5.0
    ranges[1] = None
    measured = mission.measurements().drop_columns("h_g_m")
    measured = measured.append_column("range_m", pa.array(ranges))
    mission.observe(measured)
    mission.config["observations"]["columns"] = {"distance_m": "range_m"}
    mission.config["ground"] = {"height": "from_distance"}
    assert "OBS-DISTANCE" in codes_of(mission.run_to_manifest(3))
    table = mission.results()
    assert table["range_m"][0].as_py() == -5.0
    first, second, *later = table["status"].to_pylist()
    assert first == second == "no_ground"
    assert set(later) == {"ok"}
    assert_heights(table.slice(2), corrected.slice(2))
    ideal = pixels(corrected, CORRECTED)
    by_range = pixels(table, CORRECTED)
    assert_pixels(by_range[2:], ideal[2:], 1e-5)


def test_ideal_observations_with_slant_ranges_are_displaced_as_with_heights(
    corrected, distances, mission
):
    """Ideal pixels lie on the chord: the height at a distance follows from them directly."""
    ideal = corrected.select(["image", "point", *CORRECTED])
    ideal = ideal.replace_schema_metadata(None)
    ideal = ideal.append_column("range_m", pa.array(distances))
    mission.observe(ideal)
    read_pixels_from(mission, CORRECTED)
    mission.config["observations"]["columns"]["distance_m"] = "range_m"
    mission.config["ground"] = {"height": "from_distance"}
    displace(mission)
    mission.run_to_manifest()
    displaced = mission.results()
    assert_heights(displaced, corrected)
    measured = pixels(corrected, MEASURED)
    assert_pixels(pixels(displaced, DISPLACED), measured, 1e-5)
