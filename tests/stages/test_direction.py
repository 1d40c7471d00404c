"""Whole runs by slant range, and in the other direction."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest

from tests.helpers import codes_of
from unbend.units import WGS84_A

MEASURED = ("x_px", "y_px")
CORRECTED = ("x_corrected_px", "y_corrected_px")
DISPLACED = ("x_displaced_px", "y_displaced_px")


def pixels(table, columns: tuple[str, str]) -> np.ndarray:
    return np.column_stack([table[name] for name in columns])


def read_pixels_from(mission, columns: tuple[str, str]) -> None:
    mission.config["observations"]["columns"] = dict(zip(MEASURED, columns, strict=True))


def displace(mission) -> None:
    """Let the mission apply refraction, which observations that were measured do not need."""
    mission.config["refraction"] = {"direction": "apply"}
    mission.config["accept"] = [{"code": "PLAUSIBLE-APPLY", "reason": "there and back"}]


@pytest.fixture(scope="module")
def corrected(baseline):
    return baseline.results()


@pytest.fixture(scope="module")
def distances(baseline, corrected) -> np.ndarray:
    """Straight distances [m] from the stations to the points of corrected observations."""
    height_of_image = baseline.stations().to_pandas().set_index("image")["h_msl_m"]
    h_c = height_of_image.loc[corrected["image"].to_pylist()].to_numpy()
    zeta = corrected["zeta_c_rad"].to_numpy() - corrected["r_c_rad"].to_numpy()
    r_c = WGS84_A + h_c
    r_g = WGS84_A + corrected["h_g_m"].to_numpy()
    along = r_c * np.cos(zeta)
    below = r_c**2 - r_g**2
    return below / (along + np.sqrt(along**2 - below))


def assert_heights(table, corrected) -> None:
    """The sphere here is that of the equator."""
    np.testing.assert_allclose(table["h_g_m"], corrected["h_g_m"], rtol=0.0, atol=0.01)


def test_what_was_removed_is_applied_again(corrected, mission):
    mission.observe(corrected)
    read_pixels_from(mission, CORRECTED)
    displace(mission)
    ended = mission.run()
    assert ended.code == 0, ended.text
    printed = " ".join(ended.out.split())
    assert "All 59 observations were displaced by " in printed
    assert "for simulations and tests: they now contain refraction." in printed
    assert "Ready for bundle adjustment" not in printed
    displaced = mission.results()
    assert displaced.schema.metadata[b"unbend.refraction"] == b"applied"
    assert "x_corrected_px" not in displaced.column_names
    assert displaced.column_names.index("x_displaced_px") == 4
    assert set(displaced["status"].to_pylist()) == {"ok"}
    assert np.abs(pixels(displaced, DISPLACED) - pixels(corrected, MEASURED)).max() < 1e-9
    np.testing.assert_array_equal(pixels(displaced, MEASURED), pixels(corrected, CORRECTED))
    kept = pixels(displaced, ("x_px_input", "y_px_input"))
    np.testing.assert_array_equal(kept, pixels(corrected, MEASURED))

    # And removed once more.
    mission.observe(displaced, "again.parquet")
    read_pixels_from(mission, DISPLACED)
    mission.config["refraction"] = {"direction": "remove"}
    mission.run_to_manifest()
    again = pixels(mission.results(), CORRECTED)
    assert np.abs(again - pixels(corrected, CORRECTED)).max() < 1e-9


def test_heights_from_slant_ranges(corrected, distances, mission):
    ranges = distances.copy()
    ranges[:2] = -5.0, np.nan
    measured = mission.measurements().drop_columns("h_g_m")
    mission.observe(measured.append_column("range_m", pa.array(ranges, from_pandas=True)))
    mission.config["observations"]["columns"] = {"distance_m": "range_m"}
    mission.config["ground"] = {"height": "from_distance"}
    assert "OBS-DISTANCE" in codes_of(mission.run_to_manifest(3))
    table = mission.results()
    assert table["range_m"].to_pylist()[0] == -5.0
    statuses = table["status"].to_pylist()
    assert statuses[:2] == ["no_ground"] * 2
    assert set(statuses[2:]) == {"ok"}
    assert_heights(table.slice(2), corrected.slice(2))
    miss = pixels(table, CORRECTED) - pixels(corrected, CORRECTED)
    assert np.abs(miss[2:]).max() < 1e-5


def test_ideal_observations_with_slant_ranges_are_displaced_as_with_heights(
    corrected, distances, mission
):
    """Ideal pixels lie on the chord: the height at a distance follows from them directly."""
    ideal = corrected.select(["image", "point", *CORRECTED]).replace_schema_metadata(None)
    mission.observe(ideal.append_column("range_m", pa.array(distances)))
    read_pixels_from(mission, CORRECTED)
    mission.config["observations"]["columns"]["distance_m"] = "range_m"
    mission.config["ground"] = {"height": "from_distance"}
    displace(mission)
    mission.run_to_manifest()
    displaced = mission.results()
    assert_heights(displaced, corrected)
    assert np.abs(pixels(displaced, DISPLACED) - pixels(corrected, MEASURED)).max() < 1e-5
