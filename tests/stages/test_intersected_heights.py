"""Ground heights by the intersection of the user's own rays, against the simulated terrain."""

import numpy as np
import pandas as pd
import pytest
import yaml
from numpy.testing import assert_allclose

from tests.conftest import MissionFolder
from tests.helpers import entry_of, refused
from unbend.batch import runs
from unbend.batch.runs import check_mission
from unbend.stages.multi_image import point_heights


@pytest.fixture
def truth(crossing_flight):
    return pd.read_parquet(crossing_flight.observations)


@pytest.fixture
def intersected(crossing_flight, tmp_path):
    """The mission with heights by intersection; a test gives it its table of rays."""
    log = crossing_flight.logs["bin"]
    text = crossing_flight.missions["bin"].read_text()
    config = yaml.safe_load(text)
    config["ground"] = {"height": "intersected"}
    config["log"]["path"] = str(log)
    return MissionFolder(tmp_path, "bin", config)


def with_rays(mission, table):
    """The mission with these rays, without their heights."""
    rays = table.drop(columns="h_g_m")
    rays.to_parquet(mission.folder / "own.parquet", index=False)
    mission.config["observations"]["path"] = "own.parquet"
    return mission


def results_of(mission, table):
    """The results of a run with these rays."""
    with_rays(mission, table).run()
    return mission.result_rows()


def test_heights_are_those_of_the_terrain(intersected, crossing_flight, truth):
    exit_code = with_rays(intersected, truth).run().code
    results = intersected.result_rows()
    has_height = results["h_g_m"].notna()
    assert has_height.mean() > 0.8
    assert exit_code == (0 if has_height.all() else 3)
    status = np.where(has_height, "ok", "no_ground")
    assert (results["status"] == status).all()
    height_of_point = truth.groupby("point")["h_g_m"].mean()
    off_m = results["h_g_m"] - results["point"].map(height_of_point)
    assert abs(off_m.median()) < 2.0
    assert off_m.pow(2).mean() < 10.0**2
    entry = entry_of(intersected.manifest(), "GROUND-INTERSECTED")
    assert entry["kind"] == "note"
    assert results["sigma_ground_dx_px"][has_height].notna().all()
    # Refraction goes with the height above ground: wrong by what the heights are wrong.
    true = pd.read_parquet(crossing_flight.truth / "observations.parquet")
    error = results["r_c_rad"] / true["r_c_rad"] - 1.0
    assert error[has_height].abs().median() < 0.01


KEY = ["image", "point"]


def test_rows_in_any_order_and_in_many_files_give_the_same(intersected, truth, monkeypatch):
    results = results_of(intersected, truth).set_index(KEY)
    # Smaller files and batches than those of millions of rows.
    monkeypatch.setattr(
        point_heights,
        "ROWS_OF_A_FILE",
        50,
    )
    monkeypatch.setattr(point_heights, "BATCH_ROWS", 70)
    mixed = truth.sample(frac=1.0, random_state=3)
    shuffled = results_of(intersected, mixed).set_index(KEY)
    assert len(shuffled) == len(results)
    assert shuffled.index.is_unique
    assert not shuffled.index.equals(results.index)
    heights_m = shuffled["h_g_m"].reindex(results.index)
    assert_allclose(heights_m, results["h_g_m"], atol=1e-6)


def test_a_rehearsal_has_the_heights_of_a_run_for_the_rows_it_draws(
    intersected, truth, monkeypatch
):
    """It reads the rays of the points of those rows, wherever these are in the table."""
    # A sample is fewer rows than the table has; the usual one is thousands.
    monkeypatch.setattr(runs, "SAMPLED_ROWS", 100)
    mixed = truth.sample(frac=1.0, random_state=5)
    results = results_of(intersected, mixed)
    corrected = check_mission(intersected.file).corrected
    sample = corrected.prepared.observations.sample.number
    assert 60 <= sample.size <= 100 < len(results)
    drawn = results.iloc[sample]
    assert drawn["point"].nunique() > 20
    heights_m = corrected.facts.rows.h_g_m
    # One unit in the last place of geocentric coordinates is 9e-10 m.
    assert_allclose(
        heights_m,
        drawn["h_g_m"],
        rtol=0.0,
        atol=1e-8,
    )


def test_points_of_one_image_have_no_height(intersected, truth):
    truth.loc[0, "point"] = "alone"
    manifest = with_rays(intersected, truth).run_to_manifest(3)
    results = intersected.result_rows()
    assert results["status"][0] == "no_ground"
    assert "fewer than two rays: 1" in entry_of(manifest, "GROUND-INTERSECTED")["what"]


def test_names_that_never_repeat_are_refused(intersected, truth):
    truth["point"] = truth.index.astype(str)
    file = with_rays(intersected, truth).save()
    with refused("GROUND-INTERSECTED", says="ground.height"):
        check_mission(file)
