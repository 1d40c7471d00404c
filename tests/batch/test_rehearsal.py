"""`check` says of a mission what `run` would: same codes, same exit code, and writes nothing."""

import re
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest

from tests.helpers import codes_of, entry_of, one_line, refused
from tests.tables.observed import COLUMNS
from unbend.batch.rehearsal import rehearsal_lines
from unbend.batch.runs import check_mission, run_mission
from unbend.errors import UnbendError
from unbend.messages import Ledger
from unbend.tables.observations import open_observations
from unbend.tables.row_sample import RowSample

pytestmark = pytest.mark.usefixtures("plain_report")


def renamed_column(mission):
    table = mission.measured_rows()
    table.insert(0, "h_g_m_input", 1.0)
    mission.observe_rows(table)


def config(**changes):
    """Values under dotted keys of the mission file."""

    def spoil(mission):
        for key, value in changes.items():
            *path, last = key.split("__")
            section = mission.config
            for name in path:
                section = section[name]
            section[last] = value

    return spoil


def cut_log(mission):
    content = mission.log.read_bytes()
    mission.log.write_bytes(content[:-20_000])


def set_rows(column, value, count):
    """A value in the first rows of a column of the observations."""

    def spoil(mission):
        table = mission.measured_rows()
        table.loc[: count - 1, column] = value
        mission.observe_rows(table)

    return spoil


def output_below_a_file(mission):
    mission.output.touch()
    mission.config["output"]["path"] = "results/deeper"


def report_of_the_user(mission):
    mission.output.mkdir()
    (mission.output / "report.html").write_text("mine")


def link_in_the_place_of_a_result(mission):
    mission.output.mkdir()
    (mission.output / "manifest.json").symlink_to(mission.file)


def nothing(mission):
    pass


BAD = {
    "as simulated": nothing,
    "unknown image": set_rows("image", "unknown.tif", 1),
    "no number": set_rows("x_px", np.nan, 5),
    "outside the image": set_rows("x_px", 20_000.0, 20),
    "no heights": set_rows("h_g_m", np.nan, 7),
    "heights of no ground": set_rows("h_g_m", 30_000.0, 7),
    "ground above the camera": config(ground__height=9000.0),
    "renamed column": renamed_column,
    "horizontal camera": config(mount__nadir__pitch_deg=-90.0),
    "missing channel": config(log__channels__humidity="HYGR[9]"),
    "missing log": config(log__path="none.bin"),
    "missing column": config(observations__columns={"x_px": "column"}),
    "relative": config(ground__reference="relative"),
    "limit of sigma": config(stations={"max_sigma_height_m": 0.001}),
    "focal length in mm": config(cameras__nadir__fx_px=92.0, cameras__nadir__fy_px=92.0),
    "damaged log": cut_log,
    "output below a file": output_below_a_file,
    "report of the user": report_of_the_user,
    "link in the place of a result": link_in_the_place_of_a_result,
    "barometers exchanged": config(
        log__channels__pressure="BARO[1]",
        log__channels__cabin_pressure="BARO[0]",
    ),
}


CODES = {
    "output below a file": "STORAGE-WRITE",
    "report of the user": "STORAGE-NOT-OURS",
    "link in the place of a result": "STORAGE-SYMLINK",
}
"""Refusals that no test of `run` states."""


def kinds_and_codes(manifest):
    return {(entry["kind"], entry["code"]) for entry in manifest["ledger"]}


def outcome(mission, act):
    """Exit code, and kinds and codes of the ledger, or the code of the refusal."""
    try:
        manifest = act(mission.file).manifest.values
    except UnbendError as error:
        return error.exit_code, {("refused", error.code)}
    return manifest["exit_code"], kinds_and_codes(manifest)


@pytest.mark.parametrize("change", BAD)
def test_check_says_what_run_says(mission, change):
    BAD[change](mission)
    mission.save()
    before = set(mission.folder.rglob("*"))
    checked = outcome(mission, check_mission)
    assert set(mission.folder.rglob("*")) == before
    assert checked == outcome(mission, run_mission)
    if change in CODES:
        assert checked[1] == {("refused", CODES[change])}
    if change in ("as simulated", "renamed column"):
        assert checked[0] == 0


def many_rows(mission):
    """Every observation 250 times, of each second image ten times as often; a tenth no number."""
    table = mission.measured_rows()
    is_second = table["image"].rank(method="dense") % 2 == 0
    copies = np.where(is_second, 2500, 250)
    table = table.loc[table.index.repeat(copies)]
    draws = np.random.default_rng(4).random(len(table))
    table["x_px"] = table["x_px"].mask(draws < 0.1)
    mission.observe_rows(table)


def test_a_large_table_is_sampled_and_its_counts_are_those_of_a_run(mission):
    many_rows(mission)
    rehearsal = mission.checked()
    ran = run_mission(mission.file).manifest.values

    checked = rehearsal.manifest.values
    corrected = rehearsal.corrected
    rows = ran["observations"]["rows"]
    assert rows > 70_000
    assert corrected.statistics.rows == rows
    sampled = sum(len(part.status) for part in corrected.statistics.sampled)
    assert sampled <= 20_000
    estimates = checked["observations"]["status"]
    for status, count in ran["observations"]["status"].items():
        assert estimates[status] == pytest.approx(count, abs=0.015 * rows), status
    assert codes_of(checked) == codes_of(ran)
    sample = corrected.prepared.observations.sample
    _, drawn = np.unique(corrected.facts.rows.station, return_counts=True)
    expected = np.minimum(sample.counts, drawn.max())
    assert sorted(drawn) == sorted(expected)
    for name, camera in checked["correction"]["cameras"].items():
        shift_px = ran["correction"]["cameras"][name]["shift_px"]["median"]
        assert camera["shift_px"]["median"] == pytest.approx(shift_px, rel=0.03)


ROWS_OF_IMAGES = np.array([1, 3, 200, 4000, 17, 900])
IMAGE_OF_ROW = np.repeat(list("abcdef"), ROWS_OF_IMAGES)


def row_sample(most, *parts) -> RowSample:
    sample = RowSample(most)
    for part in parts:
        sample.add(pa.array(list(part)))
    return sample


@pytest.mark.parametrize("order", ["sorted", "shuffled"])
@pytest.mark.parametrize(("most", "most_of_image"), [(50, 11), (1000, 389)])
def test_rows_are_drawn_evenly_from_every_image(most, most_of_image, order):
    """Twelve or 390 of an image would be 52 and 1,001 rows."""
    images = IMAGE_OF_ROW
    if order == "shuffled":
        images = np.random.default_rng(1).permutation(images)
    sample = row_sample(most, *np.array_split(images, 7))
    assert np.all(np.diff(sample.number) > 0)
    _, drawn = np.unique(images[sample.number], return_counts=True)
    assert drawn.tolist() == np.minimum(ROWS_OF_IMAGES, most_of_image).tolist()
    assert sample.weights.sum() == pytest.approx(ROWS_OF_IMAGES.sum())


def test_of_more_images_than_rows_some_have_one():
    sample = row_sample(4, *np.array_split(IMAGE_OF_ROW, 7))
    assert len(sample.number) == 4
    assert len(set(IMAGE_OF_ROW[sample.number])) == 4
    assert sample.weights.sum() == pytest.approx(ROWS_OF_IMAGES.sum())


def test_of_consecutive_rows_of_one_image_each_third_has_its_share():
    sample = row_sample(1000, IMAGE_OF_ROW)
    drawn = sample.number[IMAGE_OF_ROW[sample.number] == "d"]
    first = ROWS_OF_IMAGES[:3].sum()
    thirds, _ = np.histogram(drawn - first, [0, 1333, 2666, 4000])
    assert np.ptp(thirds) <= 0.05 * drawn.size + 2


def test_few_rows_are_drawn_whole_whatever_parts_they_come_in():
    sample = row_sample(
        100,
        "a",
        "a" * 9,
        "b" * 30,
    )
    assert sample.number.tolist() == list(range(40))


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_sampled_rows_are_those_of_the_table(tmp_path, kind):
    number = np.arange(3520.0)
    table = pd.DataFrame(
        {
            "x_px": number,
            "y_px": -number,
            "point": "p",
            "note": "own",
        }
    )
    table["image"] = np.repeat(["a", "b", "c"], [500, 20, 3000])
    path = tmp_path / f"o.{kind}"
    if kind == "csv":
        table.to_csv(path, index=False)
    else:
        table.to_parquet(path, index=False, row_group_size=700)
    batch = open_observations(
        path,
        COLUMNS,
        None,
        Ledger(),
        most_rows=90,
    ).sampled()
    rows = batch.x_px.astype(int)
    assert len(batch) == 90
    assert batch.rows.tolist() == rows.tolist()
    assert batch.image.to_pylist() == table["image"][rows].tolist()
    np.testing.assert_array_equal(batch.y_px, -batch.x_px)
    assert batch.users == {}
    assert batch.weight.sum() == pytest.approx(3520.0)


@pytest.mark.usefixtures("eighty_columns")
def test_ten_lines_in_80_columns(mission, unbend):
    ended = unbend("check", mission.save())
    assert max(map(len, ended.out.splitlines())) <= 80
    text = one_line(ended.out)
    lines = dict(rehearsal_lines(check_mission(mission.file)))
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


def span(values, digits):
    return f"{values.min():.{digits}g} to {values.max():.{digits}g}"


def test_the_lines_have_the_numbers_of_the_run(mission):
    lines = dict(rehearsal_lines(mission.checked()))
    run_mission(mission.file)
    stations = mission.station_rows()
    rows = (
        mission.results()
        .to_pandas()
        .merge(
            stations,
            on="image",
            suffixes=("", "_of_station"),
        )
    )
    above_m = rows["h_msl_m"] - rows["h_g_m"]
    ground = f"ground {span(rows['h_g_m'], 4)} m, take-off 450 m"
    cameras = f"cameras {span(stations['h_msl_m'], 5)} m; above ground {span(above_m, 4)} m"
    assert lines["heights"] == f"{ground}, {cameras}"
    rows["shift_px"] = shift_of(rows)
    rows["angle_deg"] = np.degrees(rows["zeta_c_rad"])
    nadir = rows[rows["camera"] == "nadir"]
    oblique = rows[rows["camera"] == "oblique"]
    shifts = f"nadir {span(nadir['shift_px'], 3)}, oblique {span(oblique['shift_px'], 3)}"
    angles = f"nadir {span(nadir['angle_deg'], 2)}, oblique {span(oblique['angle_deg'], 2)}"
    assert lines["shift"].startswith(f"{shifts} px; ")
    assert lines["nadir angles"] == f"{angles} deg"
    view = re.match(r"nadir 39 x 30 deg, (\S+) m a pixel, (\d+) x (\d+) m", lines["cameras"])
    pixel_m, width_m, height_m = map(float, view.groups())
    expected_m = above_m[nadir.index].median() / 20_000
    assert pixel_m == pytest.approx(expected_m, rel=0.05)
    assert width_m == pytest.approx(14_000 * pixel_m, rel=0.05)
    assert height_m == pytest.approx(10_600 * pixel_m, rel=0.05)
    vertical = re.match(r"deflected by (\S+) arcsec \(EGM96\), (\S+) m", lines["vertical"])
    deflection_arcsec, metres = map(float, vertical.groups())
    assert deflection_arcsec == pytest.approx(3.97, abs=0.2)  # by PROJ, as in the report's tests
    expected_m = deflection_arcsec / 206_265 * above_m.median()
    assert metres == pytest.approx(expected_m, abs=0.006)


def shift_of(rows):
    """How far corrected points are from the measured ones [px]."""
    shift_x = rows["x_corrected_px"] - rows["x_px"]
    shift_y = rows["y_corrected_px"] - rows["y_px"]
    return np.hypot(shift_x, shift_y)


def medians(lines, label):
    """What a change does to the corrections of each camera [px]."""
    for part in lines["changes by"].split("; "):
        if part.startswith(label):
            numbers = re.findall(r"(nadir|oblique) ([\d.e-]+)", part)
            return {camera: float(number) for camera, number in numbers}
    raise AssertionError(label)


def test_what_ten_metres_do_is_what_they_do(mission):
    """The ground 10 m higher in the mission file moves the corrections by what check says."""
    lines = dict(rehearsal_lines(mission.checked()))
    run_mission(mission.file)
    before = mission.result_rows()
    table = mission.measured_rows()
    mission.observe_rows(table.assign(h_g_m=table["h_g_m"] + 10.0))
    run_mission(mission.save())
    after = mission.result_rows()

    moved_x = after["x_corrected_px"] - before["x_corrected_px"]
    moved_y = after["y_corrected_px"] - before["y_corrected_px"]
    moved = np.hypot(moved_x, moved_y)
    by_ground = medians(lines, "10 m of ground")
    assert by_ground
    for camera, median in by_ground.items():
        is_of_camera = before["image"].str.startswith(camera)
        assert median == pytest.approx(moved[is_of_camera].median(), rel=0.06)
    is_oblique = before["image"].str.startswith("oblique")
    shift = shift_of(before[is_oblique])
    share = medians(lines, "5 K")["oblique"] / shift.median()
    # R goes with p/T^2: 5 K of 280 K are -3.5 %, less what the pressure aloft gains.
    assert 0.02 < share < 0.045


# ---- the folder of results


def test_the_folder_of_another_mission_is_refused(mission):
    run_mission(mission.save())
    mission.config["mission"]["name"] = "another"
    mission.save()
    for act in (check_mission, run_mission, partial(run_mission, force=True)):
        with refused("OUTPUT-OTHER") as refusal:
            act(mission.file)
        refusal.match("simulated_bin.*another")


def test_a_folder_without_permission(mission, monkeypatch):
    # Tests may run as root, who may write into every folder.
    monkeypatch.setattr("os.access", lambda path, mode: False)
    with refused("STORAGE-WRITE") as refusal:
        mission.checked()
    refusal.match("Permission denied")


# ---- accepted findings


def test_an_accepted_finding_stays_and_raises_nothing(mission):
    mission.config["mount"]["oblique"]["lever_arm_m"] = [20.0, 28.0, 45.0]
    ledger = mission.checked().manifest.values["ledger"]
    findings = {entry["code"] for entry in ledger if entry["kind"] == "finding"}
    assert "PLAUSIBLE-LEVER-ARM" in findings
    accepted = [{"code": code, "reason": "a boom"} for code in sorted(findings)]
    mission.config["accept"] = accepted
    manifest = mission.run_to_manifest()
    entry = entry_of(manifest, "PLAUSIBLE-LEVER-ARM")
    assert entry["kind"] == "warning"
    assert entry["what"].endswith("(accepted: a boom)")
    assert manifest["config"]["accept"]


def test_losses_cannot_be_accepted_and_unused_ones_are_told(mission):
    BAD["no number"](mission)
    mission.config["accept"] = [{"code": "OBS-FLAGGED", "reason": "never mind"}]
    mission.save()
    for act in (check_mission, run_mission):
        with refused("ACCEPT-LOSS"):
            act(mission.file)
    mission.config["accept"] = [{"code": "PLAUSIBLE-AIR", "reason": "cold"}]
    manifest = mission.checked().manifest.values
    assert ("warning", "ACCEPT-UNUSED") in kinds_and_codes(manifest)


def test_writing_nothing_means_nothing(mission, monkeypatch):
    """No file is opened for writing, whatever the folder holds."""
    run_mission(mission.save())
    before = times_of_files(mission)
    original = Path.open

    def reads(self, mode="r", *args, **named):
        assert not set(mode) & set("wax+"), self
        return original(self, mode, *args, **named)

    monkeypatch.setattr(Path, "open", reads)
    check_mission(mission.file)
    assert times_of_files(mission) == before


def times_of_files(mission):
    """When each file was written, without that of the lock."""
    paths = mission.folder.rglob("*")
    return {path: path.stat().st_mtime_ns for path in paths if path.name != ".lock"}
