"""Ground heights by the intersection of the user's own rays, against the simulated terrain."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml

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
def own(lines, unbend, tmp_path):
    """Runs the mission with heights by intersection: exit code, manifest, results, true heights."""
    shutil.copytree(lines.folder, tmp_path / "mission")
    config = yaml.safe_load(lines.missions["bin"].read_text(encoding="utf-8"))
    config["ground"] = {"height": "intersected"}
    truth = pq.read_table(lines.observations).to_pandas()

    def run(change=None):
        table = truth.drop(columns=["h_g_m"])
        table = table if change is None else change(table)
        table.to_parquet(tmp_path / "mission" / "own.parquet", index=False)
        config["observations"]["path"] = "own.parquet"
        path = tmp_path / "mission" / "mission.yaml"
        path.write_text(yaml.safe_dump(config), encoding="utf-8")
        ended = unbend("run", path)
        out = path.parent / config["output"]["path"]
        if not (out / "manifest.json").is_file():
            return ended, None, None, None
        manifest = json.loads((out / "manifest.json").read_text(encoding="utf-8"))
        height = truth.groupby("point")["h_g_m"].mean()
        results = pq.read_table(out / "observations").to_pandas()
        return ended, manifest, results, results["point"].map(height).to_numpy()

    return run


def entry(manifest) -> dict:
    (found,) = [e for e in manifest["ledger"] if e["code"] == "GROUND-INTERSECTED"]
    return found


def test_heights_are_those_of_the_terrain(own, lines):
    ended, manifest, results, truth = own()
    known = results["h_g_m"].notna().to_numpy()
    assert known.mean() > 0.8
    assert (results["status"] == np.where(known, "ok", "no_ground")).all()
    off = (results["h_g_m"] - truth)[known]
    assert np.abs(np.median(off)) < 2.0
    assert np.sqrt(np.mean(off**2)) < 10.0
    assert ended.code == (0 if known.all() else 3), ended.text
    assert entry(manifest)["kind"] == "note"
    assert results["sigma_ground_dx_px"].notna()[known].all()
    # Refraction goes with the height above ground: wrong by what the heights are wrong.
    given = pq.read_table(lines.truth / "observations.parquet").to_pandas()["r_c_rad"].to_numpy()
    relative = np.abs(results["r_c_rad"].to_numpy() / given - 1.0)[known]
    assert np.median(relative) < 0.01


def test_rows_in_any_order_and_in_many_files_give_the_same(own, monkeypatch):
    _, _, results, _ = own()
    key = ["image", "point"]
    first = results.set_index(key)["h_g_m"]
    monkeypatch.setattr(point_heights, "ROWS_OF_A_FILE", 50)
    monkeypatch.setattr(point_heights, "BATCH_ROWS", 70)
    _, _, shuffled, _ = own(lambda table: table.sample(frac=1.0, random_state=3))
    assert (shuffled.index.size, shuffled[key].duplicated().any()) == (results.index.size, False)
    again = shuffled.set_index(key)["h_g_m"].reindex(first.index)
    np.testing.assert_allclose(again, first, atol=1e-6)
    assert (shuffled[key].to_numpy() != results[key].to_numpy()).any()


def test_a_rehearsal_has_the_heights_of_a_run_for_the_rows_it_draws(own, tmp_path, monkeypatch):
    """It reads the rays of the points of those rows, wherever these are in the table."""
    monkeypatch.setattr(runs, "SAMPLED_ROWS", 100)
    _, _, results, _ = own(lambda table: table.sample(frac=1.0, random_state=5))
    checked = check_mission(tmp_path / "mission" / "mission.yaml")
    sample = checked.corrected.prepared.observations.sample
    assert 60 <= sample.number.size <= 100 < len(results)
    drawn = results.iloc[sample.number]
    # One unit in the last place of geocentric coordinates is 9e-10 m.
    np.testing.assert_allclose(
        checked.corrected.facts.rows.h_g_m, drawn["h_g_m"], rtol=0.0, atol=1e-8
    )
    assert drawn["point"].nunique() > 20


def test_points_of_one_image_have_no_height(own):
    def single(table):
        row = table.index[table["point"] == table["point"].iloc[0]]
        return table.assign(point=table["point"].where(table.index != row[0], "alone"))

    ended, manifest, results, _ = own(single)
    assert results.loc[results["point"] == "alone", "status"].tolist() == ["no_ground"]
    assert ended.code == 3
    assert "fewer than two rays: 1" in entry(manifest)["what"]


def test_names_that_never_repeat_are_refused(own):
    ended, *_ = own(lambda table: table.assign(point=[f"p{n}" for n in range(len(table))]))
    assert ended.code == 6
    assert "GROUND-INTERSECTED" in ended.err
    assert "ground.height" in ended.err
