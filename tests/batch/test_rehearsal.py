"""`check` says of a mission what `run` would: same codes, same exit code, and writes nothing."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from unbend.batch import rehearsal
from unbend.batch.runs import check_mission, run_mission
from unbend.errors import ConfigError, MissionError, StorageError, UnbendError
from unbend.messages import Ledger
from unbend.tables.observations import open_observations
from unbend.tables.row_sample import RowSample

pytestmark = pytest.mark.usefixtures("plain_report")

COLUMNS = {"image": "image", "point": "point", "x_px": "x_px", "y_px": "y_px"}


def rows(change):
    """A change of the table of observations."""

    def spoil(mission):
        table = mission.measurements().to_pandas()
        change(table)
        mission.observe(pa.Table.from_pandas(table, preserve_index=False))

    return spoil


def config(**changes):
    """Values under dotted keys of the mission file."""

    def spoil(mission):
        for key, value in changes.items():
            *path, last = key.split("__")
            at = mission.config
            for part in path:
                at = at[part]
            at[last] = value

    return spoil


def cut_log(mission):
    mission.log.write_bytes(mission.log.read_bytes()[:-20_000])


def set_rows(column, value, which=slice(None)):
    def change(table):
        table.loc[table.index[which], column] = value

    return rows(change)


BAD = {
    "as simulated": lambda mission: None,
    "unknown image": set_rows("image", "unknown.tif", slice(0, 1)),
    "no number": set_rows("x_px", np.nan, slice(0, 5)),
    "outside the image": set_rows("x_px", 20_000.0, slice(0, 20)),
    "no heights": set_rows("h_g_m", np.nan, slice(0, 7)),
    "heights of no ground": set_rows("h_g_m", 30_000.0, slice(0, 7)),
    "ground above the camera": config(ground__height=9000.0),
    "renamed column": rows(lambda table: table.insert(0, "h_g_m_input", 1.0)),
    "horizontal camera": config(mount__nadir__pitch_deg=-90.0),
    "missing channel": config(log__channels__humidity="HYGR[9]"),
    "missing log": config(log__path="none.bin"),
    "missing column": config(observations__columns={"x_px": "column"}),
    "relative": config(ground__reference="relative"),
    "limit of sigma": config(stations={"max_sigma_height_m": 0.001}),
    "focal length in mm": config(cameras__nadir__fx_px=92.0, cameras__nadir__fy_px=92.0),
    "damaged log": cut_log,
    "barometers exchanged": config(
        log__channels__pressure="BARO[1]", log__channels__cabin_pressure="BARO[0]"
    ),
}


def outcome(mission, act) -> tuple[int, set[tuple[str, str]]]:
    """Exit code, and kinds and codes of the ledger, or the code of the refusal."""
    try:
        manifest = act(mission.save()).manifest.values
    except UnbendError as error:
        return error.exit_code, {("refused", error.code)}
    return manifest["exit_code"], {(e["kind"], e["code"]) for e in manifest["ledger"]}


@pytest.mark.parametrize("what", BAD)
def test_check_says_what_run_says(mission, what):
    BAD[what](mission)
    before = {path: path.stat().st_mtime_ns for path in mission.folder.rglob("*")}
    mission.save()
    checked = outcome(mission, check_mission)
    after = set(mission.folder.rglob("*"))
    assert after == {*before, mission.file}
    assert checked == outcome(mission, run_mission)
    if what in ("as simulated", "renamed column"):
        assert checked[0] == 0


def many_rows(mission, times: int) -> None:
    """Every observation several times, some images far more often; a fifth of them no number."""
    table = mission.measurements().to_pandas()
    rng = np.random.default_rng(4)
    weight = table["image"].map(
        {name: 1 + 9 * (i % 2) for i, name in enumerate(sorted(table["image"].unique()))}
    )
    table = table.loc[table.index.repeat(weight * times)].reset_index(drop=True)
    table.loc[rng.random(len(table)) < 0.1, "x_px"] = np.nan
    mission.observe(pa.Table.from_pandas(table, preserve_index=False))


def test_a_large_table_is_sampled_and_its_counts_are_those_of_a_run(mission):
    many_rows(mission, 250)
    checked = check_mission(mission.save())
    ran = run_mission(mission.save())
    total = ran.manifest.values["observations"]
    assert total["rows"] > 70_000
    assert checked.corrected.statistics.rows == total["rows"]
    assert sum(len(part.status) for part in checked.corrected.statistics.sampled) <= 20_000
    expected = checked.manifest.values["observations"]["status"]
    for status, count in total["status"].items():
        assert expected[status] == pytest.approx(count, abs=0.015 * total["rows"]), status
    assert {e["code"] for e in checked.manifest.values["ledger"]} == {
        e["code"] for e in ran.manifest.values["ledger"]
    }
    of_image = np.unique(checked.corrected.facts.rows.station, return_counts=True)[1]
    own = checked.corrected.prepared.observations.sample.counts
    assert sorted(of_image) == sorted(np.minimum(own, of_image.max()))
    shift = {
        n: c["shift_px"]["median"] for n, c in ran.manifest.values["correction"]["cameras"].items()
    }
    for name, camera in checked.manifest.values["correction"]["cameras"].items():
        assert camera["shift_px"]["median"] == pytest.approx(shift[name], rel=0.03)


@pytest.mark.parametrize("most", [4, 50, 1000])
def test_rows_are_drawn_evenly_from_every_image(most):
    rng = np.random.default_rng(1)
    counts = np.array([1, 3, 200, 4000, 17, 900])
    names = np.repeat([f"i{k}" for k in range(6)], counts)
    drawn = {}
    for order in ("sorted", "shuffled"):
        rows = names if order == "sorted" else rng.permutation(names)
        sample = RowSample(most)
        for part in np.array_split(rows, 7):
            sample.add(pa.array(part.tolist()))
        assert sample.number.size <= most
        assert np.all(np.diff(sample.number) > 0)
        drawn[order] = pd.Series(rows[sample.number]).value_counts()
        assert sample.weights.sum() == pytest.approx(counts.sum())
        if most < 6:
            continue
        assert set(drawn[order].index) == set(names)
        level = drawn[order].max()
        for name, count in zip(np.unique(names), counts, strict=True):
            assert drawn[order][name] == min(count, level)
        # As many as fit: two more of each would be too many.
        assert np.minimum(counts, level + 2).sum() > most or level == counts.max()
    # Of consecutive rows of one image each third has its share.
    if most == 1000:
        rows = sample_of_sorted = RowSample(most)
        sample_of_sorted.add(pa.array(names.tolist()))
        of_large = sample_of_sorted.number[names[rows.number] == "i3"] - counts[:3].sum()
        thirds = np.histogram(of_large, [0, 1333, 2666, 4000])[0]
        assert thirds.max() - thirds.min() <= 0.05 * of_large.size + 2


def test_few_rows_are_drawn_whole_whatever_parts_they_come_in():
    sample = RowSample(100)
    for part in (["a"], ["a"] * 9, ["b"] * 30):
        sample.add(pa.array(part))
    assert sample.number.tolist() == list(range(40))


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_sampled_rows_are_those_of_the_table(tmp_path, kind):
    table = pd.DataFrame(
        {
            "image": np.repeat(["a", "b", "c"], [500, 20, 3000]),
            "point": "p",
            "x_px": np.arange(3520.0),
            "y_px": -np.arange(3520.0),
            "note": "own",
        }
    )
    path = tmp_path / f"o.{kind}"
    table.to_csv(path, index=False) if kind == "csv" else pq.write_table(
        pa.Table.from_pandas(table, preserve_index=False), path, row_group_size=700
    )
    observations = open_observations(path, COLUMNS, None, Ledger(), most_rows=90)
    batch = observations.sampled()
    rows = batch.x_px.astype(int)
    assert len(batch) == 90
    assert batch.image.to_pylist() == table["image"][rows].tolist()
    np.testing.assert_array_equal(batch.y_px, -batch.x_px)
    assert batch.users == {}
    assert batch.weight.sum() == pytest.approx(3520.0)


@pytest.mark.usefixtures("eighty_columns")
def test_ten_lines_in_80_columns(mission, unbend):
    ended = unbend("check", mission.save())
    assert max(map(len, ended.out.splitlines())) <= 80
    text = re.sub(r"\s+", " ", ended.out)
    checked = check_mission(mission.file)
    lines = dict(rehearsal.rehearsal_lines(checked))
    assert list(lines) == [
        "datum",
        "heights",
        "cameras",
        "nadir angles",
        "time",
        "shift",
        "changes by",
        "rows",
        "vertical",
        "air",
    ]
    for label, line in lines.items():
        assert f"{label} {line}" in text
    # Simulated: field 450 m and cameras 2500 m above it, undulation 47.6 m, f 20000 px, 45 deg.
    assert "undulation 47.6 m (mission.undulation_m)" in lines["datum"]
    assert "take-off 450 m" in lines["heights"]
    assert "nadir 39 x 30 deg" in lines["cameras"]  # 2 atan(7000 / 20000), 2 atan(5300 / 20000)
    assert "59 ok" in lines["rows"]


def numbers(text: str, label: str) -> dict[str, float]:
    part = next(p for p in text.split("; ") if p.startswith(label))
    return {name: float(value) for name, value in re.findall(r"(nadir|oblique) ([\d.e-]+)", part)}


def test_what_ten_metres_do_is_what_they_do(mission):
    """The ground 10 m higher in the mission file moves the corrections by what check says."""
    text = dict(rehearsal.rehearsal_lines(check_mission(mission.save())))["changes by"]
    run_mission(mission.save())
    before = mission.results().to_pandas()
    table = mission.measurements().to_pandas()
    mission.observe(pa.Table.from_pandas(table.assign(h_g_m=table["h_g_m"] + 10.0)))
    run_mission(mission.save())
    after = mission.results().to_pandas()
    moved = np.hypot(*(after[c] - before[c] for c in ("x_corrected_px", "y_corrected_px")))
    for name, value in numbers(text, "10 m of ground").items():
        median = moved[before["image"].str.startswith(name)].median()
        assert value == pytest.approx(median, rel=0.06)
    five_k = numbers(text, "5 K")["oblique"]
    shift = np.hypot(
        before["x_corrected_px"] - before["x_px"], before["y_corrected_px"] - before["y_px"]
    )
    share = five_k / shift[before["image"].str.startswith("oblique")].median()
    # R goes with p/T^2: 5 K of 280 K are -3.5 %, less what the pressure aloft gains.
    assert 0.02 < share < 0.045


# ---- the folder of results


def test_the_folder_of_another_mission_is_refused(mission):
    run_mission(mission.save())
    mission.config["mission"]["name"] = "another"
    for act in (check_mission, run_mission):
        with pytest.raises(ConfigError, match=r"OUTPUT-OTHER.*simulated_bin.*another"):
            act(mission.save())
    with pytest.raises(ConfigError, match="OUTPUT-OTHER"):
        run_mission(mission.save(), force=True)


def test_folders_that_cannot_be_written_to(mission, unbend):
    (mission.folder / "file").write_text("")
    mission.config["output"]["path"] = "file/results"
    with pytest.raises(StorageError, match="STORAGE-WRITE"):
        check_mission(mission.save())
    mission.config["output"]["path"] = "own"
    (mission.folder / "own").mkdir()
    (mission.folder / "own" / "report.html").write_text("mine")
    with pytest.raises(StorageError, match="STORAGE-NOT-OURS"):
        check_mission(mission.save())
    assert [p.name for p in (mission.folder / "own").iterdir()] == ["report.html"]
    (mission.folder / "own" / "report.html").unlink()
    (mission.folder / "own" / "manifest.json").symlink_to(mission.file)
    with pytest.raises(StorageError, match="STORAGE-SYMLINK"):
        check_mission(mission.save())


def test_a_folder_without_permission(mission, monkeypatch):
    monkeypatch.setattr("os.access", lambda path, mode: False)
    with pytest.raises(StorageError, match="STORAGE-WRITE: Permission denied"):
        check_mission(mission.save())


def test_two_missions_of_one_folder_in_check(mission, unbend):
    first = mission.save()
    second = first.with_name("second.yaml")
    second.write_text(first.read_text(encoding="utf-8").replace("simulated_bin", "other"))
    ended = unbend("check", first, second)
    assert (ended.code, "OUTPUT-SHARED" in ended.err) == (6, True)


# ---- accepted findings


def test_an_accepted_finding_stays_and_raises_nothing(mission):
    mission.config["mount"]["oblique"]["lever_arm_m"] = [20.0, 28.0, 55.0]
    codes = {
        e["code"]
        for e in check_mission(mission.save()).manifest.values["ledger"]
        if e["kind"] == "finding"
    }
    assert "PLAUSIBLE-LEVER-ARM" in codes
    mission.config["accept"] = [{"code": code, "reason": "a boom"} for code in sorted(codes)]
    ended = run_mission(mission.save())
    entry = next(e for e in ended.manifest.values["ledger"] if e["code"] == "PLAUSIBLE-LEVER-ARM")
    assert (entry["kind"], ended.exit_code) == ("warning", 0)
    assert entry["what"].endswith("(accepted: a boom)")
    assert json.loads((ended.output / "manifest.json").read_text())["config"]["accept"]


def test_losses_cannot_be_accepted_and_unused_ones_are_told(mission):
    BAD["no number"](mission)
    mission.config["accept"] = [{"code": "OBS-FLAGGED", "reason": "never mind"}]
    for act in (check_mission, run_mission):
        with pytest.raises(MissionError, match="ACCEPT-LOSS"):
            act(mission.save())
    mission.config["accept"] = [{"code": "PLAUSIBLE-AIR", "reason": "cold"}]
    manifest = check_mission(mission.save()).manifest.values
    assert ("warning", "ACCEPT-UNUSED") in {(e["kind"], e["code"]) for e in manifest["ledger"]}


def test_writing_nothing_means_nothing(mission, monkeypatch):
    """No file is opened for writing, whatever the folder holds."""
    run_mission(mission.save())
    before = {p: p.stat().st_mtime_ns for p in mission.folder.rglob("*")}
    real = Path.open

    def reads(self, mode="r", *args, **named):
        assert not set(mode) & set("wax+"), self
        return real(self, mode, *args, **named)

    monkeypatch.setattr(Path, "open", reads)
    check_mission(mission.file)
    assert before.keys() == {*mission.folder.rglob("*")}
    assert all(p.stat().st_mtime_ns == t for p, t in before.items() if p.name != ".lock")
