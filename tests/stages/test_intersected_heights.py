"""Ground heights by the intersection of the user's own rays, against the simulated terrain."""

from __future__ import annotations

import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml

from tests.conftest import MissionFolder
from tests.helpers import entry_of, refused
from unbend.batch import runs
from unbend.batch.runs import check_mission
from unbend.simulate import SimulationOptions, simulate
from unbend.stages.multi_image import point_heights

pytestmark = pytest.mark.usefixtures("plain_report")


@pytest.fixture(scope="module")
def lines(tmp_path_factory):
    """Three lines whose cameras and stations have noise, as a log and a table of rays."""
    options = SimulationOptions(
        seed=4,
        height_above_ground_m=2500.0,
        lines=3,
        exposures_per_line=5,
        points_per_image=20,
        image_noise_px=0.3,
    )
    return simulate(tmp_path_factory.mktemp("lines"), options)


@pytest.fixture
def truth(lines):
    return pq.read_table(lines.observations).to_pandas()


@pytest.fixture
def intersected(lines, tmp_path):
    """The mission with heights by intersection; a test gives it its table of rays."""
    config = yaml.safe_load(lines.missions["bin"].read_text(encoding="utf-8"))
    config["ground"] = {"height": "intersected"}
    config["log"]["path"] = str(lines.logs["bin"])
    return MissionFolder(tmp_path, "bin", config)


def with_rays(mission, table) -> MissionFolder:
    """The mission with these rays, without their heights."""
    table.drop(columns="h_g_m").to_parquet(mission.folder / "own.parquet", index=False)
    mission.config["observations"]["path"] = "own.parquet"
    return mission


def test_heights_are_those_of_the_terrain(intersected, lines, truth):
    ended = with_rays(intersected, truth).run()
    results = intersected.results().to_pandas()
    known = results["h_g_m"].notna()
    assert known.mean() > 0.8
    assert ended.code == (0 if known.all() else 3), ended.text
    assert (results["status"] == np.where(known, "ok", "no_ground")).all()
    height = truth.groupby("point")["h_g_m"].mean()
    off = (results["h_g_m"] - results["point"].map(height))[known]
    assert abs(off.median()) < 2.0
    assert np.sqrt(np.mean(off**2)) < 10.0
    assert entry_of(intersected.manifest(), "GROUND-INTERSECTED")["kind"] == "note"
    assert results.loc[known, "sigma_ground_dx_px"].notna().all()
    # Refraction goes with the height above ground: wrong by what the heights are wrong.
    given = pq.read_table(lines.truth / "observations.parquet").to_pandas()["r_c_rad"]
    assert (results["r_c_rad"] / given - 1.0)[known].abs().median() < 0.01


KEY = ["image", "point"]


def test_rows_in_any_order_and_in_many_files_give_the_same(intersected, truth, monkeypatch):
    with_rays(intersected, truth).run()
    results = intersected.results().to_pandas()
    monkeypatch.setattr(point_heights, "ROWS_OF_A_FILE", 50)
    monkeypatch.setattr(point_heights, "BATCH_ROWS", 70)
    with_rays(intersected, truth.sample(frac=1.0, random_state=3)).run()
    shuffled = intersected.results().to_pandas()
    assert len(shuffled) == len(results)
    assert not shuffled[KEY].duplicated().any()
    assert (shuffled[KEY].to_numpy() != results[KEY].to_numpy()).any()
    height = results.set_index(KEY)["h_g_m"]
    again = shuffled.set_index(KEY)["h_g_m"].reindex(height.index)
    np.testing.assert_allclose(again, height, atol=1e-6)


def test_a_rehearsal_has_the_heights_of_a_run_for_the_rows_it_draws(
    intersected, truth, monkeypatch
):
    """It reads the rays of the points of those rows, wherever these are in the table."""
    monkeypatch.setattr(runs, "SAMPLED_ROWS", 100)
    with_rays(intersected, truth.sample(frac=1.0, random_state=5)).run()
    results = intersected.results().to_pandas()
    corrected = check_mission(intersected.file).corrected
    sample = corrected.prepared.observations.sample.number
    assert 60 <= sample.size <= 100 < len(results)
    drawn = results.iloc[sample]
    assert drawn["point"].nunique() > 20
    # One unit in the last place of geocentric coordinates is 9e-10 m.
    np.testing.assert_allclose(corrected.facts.rows.h_g_m, drawn["h_g_m"], rtol=0.0, atol=1e-8)


def test_points_of_one_image_have_no_height(intersected, truth):
    truth.loc[0, "point"] = "alone"
    manifest = with_rays(intersected, truth).run_to_manifest(3)
    results = intersected.results().to_pandas()
    assert results["status"][0] == "no_ground"
    assert "fewer than two rays: 1" in entry_of(manifest, "GROUND-INTERSECTED")["what"]


def test_names_that_never_repeat_are_refused(intersected, truth):
    mission = with_rays(intersected, truth.assign(point=truth.index.astype(str)))
    with refused("GROUND-INTERSECTED") as refusal:
        check_mission(mission.save())
    assert "ground.height" in str(refusal.value)
