"""Whole runs by slant range, and in the other direction."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from unbend.units import WGS84_A


def pixels(table, kind):
    return np.stack([table[f"{a}_{kind}px"].to_numpy() for a in "xy"], 1)


def chords(mission, table) -> np.ndarray:
    """Straight distances [m] from the stations to the points of corrected observations."""
    stations = {s["image"]: s["h_msl_m"] for s in mission.stations().to_pylist()}
    h_c = np.array([stations[name] for name in table["image"].to_pylist()])
    zeta = table["zeta_c_rad"].to_numpy() - table["r_c_rad"].to_numpy()
    r_c = WGS84_A + h_c
    r_g = WGS84_A + table["h_g_m"].to_numpy()
    along = r_c * np.cos(zeta)
    return (r_c**2 - r_g**2) / (along + np.sqrt(along**2 - (r_c**2 - r_g**2)))


def test_what_was_removed_is_applied_again(baseline, mission, plain_report):
    corrected = baseline.results()
    mission.observe(corrected)
    mission.config["observations"]["columns"] = {"x_px": "x_corrected_px", "y_px": "y_corrected_px"}
    mission.config["refraction"] = {"direction": "apply"}
    mission.config["accept"] = [{"code": "PLAUSIBLE-APPLY", "reason": "there and back"}]
    ended = mission.run()
    assert ended.code == 0, ended.text
    printed = " ".join(ended.out.split())
    assert "All 59 observations were displaced by " in printed
    assert "for simulations and tests: they now contain refraction." in printed
    assert "Ready for bundle adjustment" not in printed
    found = mission.results()
    assert found.schema.metadata[b"unbend.refraction"] == b"applied"
    assert "x_corrected_px" not in found.column_names
    assert found.column_names.index("x_displaced_px") == 4
    assert set(found["status"].to_pylist()) == {"ok"}
    assert np.abs(pixels(found, "displaced_") - pixels(corrected, "")).max() < 1e-9
    np.testing.assert_array_equal(pixels(found, ""), pixels(corrected, "corrected_"))
    np.testing.assert_array_equal(
        pixels(corrected, ""), np.stack([found[f"{a}_px_input"].to_numpy() for a in "xy"], 1)
    )

    # And removed once more.
    mission.observe(found, "again.parquet")
    mission.config["observations"]["columns"] = {"x_px": "x_displaced_px", "y_px": "y_displaced_px"}
    mission.config["refraction"] = {"direction": "remove"}
    ended = mission.run()
    assert ended.code == 0, ended.text
    assert (
        np.abs(pixels(mission.results(), "corrected_") - pixels(corrected, "corrected_")).max()
        < 1e-9
    )


def test_heights_from_slant_ranges(baseline, mission, plain_report):
    corrected = baseline.results()
    distance = chords(baseline, corrected)
    distance[0], distance[1] = -5.0, np.nan
    measured = mission.measurements().drop_columns("h_g_m")
    mission.observe(measured.append_column("range_m", pa.array(distance, from_pandas=True)))
    mission.config["observations"]["columns"] = {"distance_m": "range_m"}
    mission.config["ground"] = {"height": "from_distance"}
    ended = mission.run()
    assert ended.code == 3, ended.text
    assert "OBS-DISTANCE" in str(mission.output.joinpath("manifest.json").read_text())
    found = mission.results()
    assert found["status"].to_pylist()[:3] == ["no_ground", "no_ground", "ok"]
    assert set(found["status"].to_pylist()[2:]) == {"ok"}
    off = found["h_g_m"].to_numpy()[2:] - corrected["h_g_m"].to_numpy()[2:]
    assert np.abs(off).max() < 0.01  # the sphere here is that of the equator
    miss = pixels(found, "corrected_")[2:] - pixels(corrected, "corrected_")[2:]
    assert np.abs(miss).max() < 1e-5
    assert found["range_m"].to_pylist()[0] == -5.0


def test_ideal_observations_with_slant_ranges_are_displaced_as_with_heights(
    baseline, mission, plain_report
):
    """Ideal pixels lie on the chord: the height at a distance follows from them directly."""
    corrected = baseline.results()
    ideal = corrected.select(["image", "point", "x_corrected_px", "y_corrected_px"])
    ideal = ideal.append_column("range_m", pa.array(chords(baseline, corrected)))
    mission.observe(ideal.replace_schema_metadata(None))
    mission.config["observations"]["columns"] = {
        "x_px": "x_corrected_px",
        "y_px": "y_corrected_px",
        "distance_m": "range_m",
    }
    mission.config["ground"] = {"height": "from_distance"}
    mission.config["refraction"] = {"direction": "apply"}
    mission.config["accept"] = [{"code": "PLAUSIBLE-APPLY", "reason": "there and back"}]
    ended = mission.run()
    assert ended.code == 0, ended.text
    displaced = mission.results()
    off = displaced["h_g_m"].to_numpy() - corrected["h_g_m"].to_numpy()
    assert np.abs(off).max() < 0.01  # the sphere here is that of the equator
    assert np.abs(pixels(displaced, "displaced_") - pixels(corrected, "")).max() < 1e-5
