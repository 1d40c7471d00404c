"""Campaigns: what runs and what does not, and how that is known; the page and the table."""

import json
import os
import shutil
import time
from dataclasses import dataclass
from html.parser import HTMLParser
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
import yaml

from tests.batch.conftest import flip_a_byte
from tests.conftest import run_command, without_plots
from tests.weather_texts import sounding_text
from unbend.batch import input_files, runs, unchanged
from unbend.batch.campaigns import select_missions
from unbend.config.campaign import MissionRef

OWN = ("mission", "log", "observations", "events")


@dataclass
class Season:
    """A campaign of copies of one mission, each with a log, a table and a sounding of its own."""

    folder: Path

    @property
    def file(self):
        return self.folder / "season.yaml"

    def flight(self, number):
        return self.folder / "flights" / f"f{number}"

    @property
    def table(self):
        return self.folder / "results" / "campaign.parquet"

    @property
    def page(self):
        return self.folder / "results" / "campaign.html"

    def manifest(self, number):
        return self.folder / "results" / f"flight-{number}" / "manifest.json"

    def values(self, number):
        """The manifest of a mission as JSON."""
        return json.loads(self.manifest(number).read_text())

    def rows(self):
        """The rows of the table."""
        return pq.read_table(self.table).to_pylist()

    def states(self):
        """State and code of each mission in the table."""
        states = []
        for row in self.rows():
            states.append((row["state"], row["code"]))
        return states

    def older(self):
        """Files that were written some seconds ago; newer ones are not trusted."""
        files = self.folder.rglob("*")
        latest = max(file.lstat().st_ctime for file in files)
        settled = latest + input_files.SETTLED_NS * 1e-9 + 0.05
        time.sleep(max(0.0, settled - time.time()))

    def unchanged(self):
        """Numbers of the missions that are known to be unchanged without checking their files."""
        chosen = select_missions([self.file])
        missions = enumerate(chosen.missions)
        return [number for number, ref in missions if chosen.is_unchanged(ref)]

    def change_mission(self, number, **sections):
        """Give a mission file other sections."""
        file = self.flight(number) / "mission.yaml"
        whole = yaml.safe_load(file.read_text()) | sections
        file.write_text(yaml.safe_dump(whole))


def make_season(mission, folder) -> Season:
    """Of two missions."""
    season = Season(folder)
    shared = dict(mission.config)
    del shared["output"]
    sections = {key: shared.pop(key) for key in OWN}
    sections["atmosphere"] = {"soundings": [{"path": "balloon.csv"}]}
    for number in (0, 1):
        flight = season.flight(number)
        flight.mkdir(parents=True)
        shutil.copy(mission.log, flight / "flight.bin")
        shutil.copy(mission.folder / "observations.parquet", flight)
        (flight / "balloon.csv").write_text(sounding_text(), "utf-8")
        sections["mission"]["name"] = f"flight-{number}"
        (flight / "mission.yaml").write_text(yaml.safe_dump(sections), "utf-8")
    content = {
        "campaign": {"name": "season", "output": "results"},
        "defaults": shared,
        "missions": ["flights/*/mission.yaml"],
    }
    text = yaml.safe_dump(content, sort_keys=False)
    season.file.write_text(text, "utf-8")
    return season


@pytest.fixture
def own_cache(tmp_path, monkeypatch):
    """A user's cache of the test's own, empty; a file settles in 0.2 s."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    # Two seconds in each of two dozen tests otherwise.
    monkeypatch.setattr(input_files, "SETTLED_NS", 200_000_000)


@pytest.fixture
def season(mission, tmp_path, own_cache, plain_report) -> Season:
    return make_season(mission, tmp_path / "season")


@pytest.fixture(scope="module")
def finished(mission_factory, tmp_path_factory, computed_once) -> Season:
    """A campaign that ran. Not to be changed."""
    folder = tmp_path_factory.mktemp("campaign")
    ran = make_season(mission_factory(folder / "mission"), folder / "season")
    with without_plots():
        ended = run_command("run", ran.file)
    assert ended.code == 0, ended.text
    return ran


@pytest.fixture
def done(finished, tmp_path, own_cache, plain_report, obeyed) -> Season:
    """A copy of a campaign that ran, whose manifests know its files."""
    season = Season(tmp_path / "season")
    shutil.copytree(finished.folder, season.folder)
    season.older()
    text = obeyed("run", season.file)  # it is in another place, and is the same
    assert text.count("nothing to do") == 2
    assert season.unchanged() == [0, 1]
    return season


def test_one_changed_sounding_runs_one_mission(done, obeyed):
    unchanged_file = done.manifest(0)
    changed_file = done.manifest(1)
    unchanged_ns = unchanged_file.stat().st_mtime_ns
    changed_ns = changed_file.stat().st_mtime_ns
    sounding = done.flight(1) / "balloon.csv"
    sounding.write_text(sounding_text(0.5), "utf-8")
    first, second = json.loads(obeyed("status", done.file, "--json"))
    assert not first["would_run"]
    assert second["would_run"]
    assert "sounding 1 changed (balloon.csv)" in str(second["reasons"])

    text = obeyed("run", done.file)

    assert unchanged_file.stat().st_mtime_ns == unchanged_ns
    assert changed_file.stat().st_mtime_ns != changed_ns
    first, second = done.rows()
    assert first["fingerprint"] == done.values(0)["fingerprint"]
    assert second["fingerprint"] == done.values(1)["fingerprint"]
    (line,) = (line for line in text.splitlines() if "report.html" in line)
    assert line.startswith(f"{second['mission']}: {second['corrected']:,} of ")
    assert "95 % below " in line
    assert first["shift_maximum_px"] != second["shift_maximum_px"]  # another air


def test_of_an_unchanged_campaign_no_file_is_checked_and_no_input_opened(done, monkeypatch):
    def fail(thing):
        pytest.fail(f"{thing} was opened")

    monkeypatch.setattr(MissionRef, "load", fail)
    monkeypatch.setattr(input_files, "hash_file", fail)
    assert done.unchanged() == [0, 1]


def append(file):
    file.write_bytes(file.read_bytes() + b"\n")


@pytest.mark.parametrize(
    ("path", "change"),
    [
        ("flights/f0/flight.bin", append),
        ("flights/f0/flight.bin", flip_a_byte),
        ("flights/f0/observations.parquet", Path.unlink),
        ("flights/f0/mission.yaml", append),
        ("results/flight-0/report.html", Path.unlink),
        ("results/flight-0/stations.parquet", flip_a_byte),
        ("results/flight-0/observations/part-00000.parquet", flip_a_byte),
        ("results/flight-0/observations/part-00009.parquet", Path.touch),
        ("results/flight-0/manifest.json", Path.unlink),
        ("results/flight-0/.staging", Path.mkdir),
        ("results/flight-0", shutil.rmtree),
    ],
)
def test_no_change_goes_unseen(done, path, change):
    change(done.folder / path)
    assert done.unchanged() == [1]


def test_what_is_as_it_was_again_is_known_after_a_comparison(done, unbend, obeyed):
    """Copied back, with times of its own; files of just now are not trusted."""
    log = done.flight(0) / "flight.bin"
    log.write_bytes(log.read_bytes())
    assert done.unchanged() == [1]
    obeyed("run", done.file)
    done.older()
    assert unbend("run", done.file).code == 0  # the first time its time may have been too young
    assert done.unchanged() == [0, 1]


def test_a_new_file_beside_a_raster_is_a_change(tmp_path):
    raster = tmp_path / "geoid.tif"
    raster.write_bytes(b"raster")
    past_s = time.time() - 60
    os.utime(raster, (past_s, past_s))
    named = input_files.NamedInput(
        "geoid",
        "mission.geoid",
        "geoid.tif",
        input_files.GDAL,
    )

    def record_now():
        files = input_files.files_of(raster, input_files.GDAL)
        states = [input_files.state_of(file)._replace(ctime_ns=0) for file in files]
        return input_files.record_of(named, files, tuple(states))

    before = record_now()
    assert before.mtime_ns is not None
    (tmp_path / "geoid.tif.aux.xml").write_text("<PAMDataset/>")
    assert not record_now().is_unchanged_since(before)


def test_another_program_knows_nothing(done, monkeypatch):
    def other_versions(roles, standard):
        return {"unbend": "other"}

    monkeypatch.setattr(unchanged, "versions_of", other_versions)
    assert done.unchanged() == []


def test_other_defaults_are_other_missions(done):
    text = done.file.read_text()
    done.file.write_text(text.replace("reference: msl", "reference: msl\n    sigma_m: 0.5"))
    assert done.unchanged() == []
    done.file.write_text(text)
    assert done.unchanged() == [0, 1]


@pytest.mark.parametrize("option", ["--force", "--verify-inputs"])
def test_asked_to_look_again_it_looks(done, obeyed, monkeypatch, option):
    make_plan = Mock(wraps=runs.make_plan)
    monkeypatch.setattr(runs, "make_plan", make_plan)
    obeyed("run", done.file, option, "--mission", "flight-0")
    make_plan.assert_called_once()


def test_a_mission_that_an_unchanged_one_shares_a_folder_with_is_refused(done, refusal_of):
    """Although the other is not run."""
    mission_file = done.flight(0) / "mission.yaml"
    whole = yaml.safe_load(done.file.read_text())["defaults"]
    whole |= yaml.safe_load(mission_file.read_text())
    whole["log"]["path"] = "nowhere"
    whole["observations"]["path"] = "nowhere"
    whole["output"] = {"path": "results/flight-0"}
    other = done.folder / "other.yaml"
    other.write_text(yaml.safe_dump(whole))
    refusal_of("OUTPUT-SHARED", 6, "run", done.file, other)


@pytest.mark.parametrize(
    ("section", "code", "words"),
    [
        ({"mission": {"name": "twin"}}, "CAMPAIGN-SAME-NAME", "twin"),
        ({"output": {"path": "../r"}}, "CAMPAIGN-SAME-OUTPUT", "flight-0 and flight-1"),
    ],
    ids=["name", "output"],
)
@pytest.mark.parametrize("command", ["run", "check", "status"])
def test_two_missions_of_one_are_refused_before_anything(
    season, refusal_of, section, code, words, command
):
    for number in (0, 1):
        season.change_mission(number, **section)
    before = set(season.folder.rglob("*"))
    text = refusal_of(code, 2, command, season.file)
    assert words in text
    assert set(season.folder.rglob("*")) == before


def test_one_mission_of_a_campaign_and_what_is_refused(season, unbend, obeyed):
    no_mission = unbend("run", season.file, "--mission", "flight-9")
    assert "CAMPAIGN-MISSION" in no_mission.err
    (season.flight(1) / "observations.parquet").unlink()
    obeyed("run", season.file, "--mission", "flight-0")
    assert season.states() == [("done", None), ("not run", None)]

    obeyed("run", season.file, exit_code=6)
    assert season.states() == [("done", None), ("refused", "INPUT-MISSING")]
    assert season.rows()[1]["exit_code"] == 6
    assert "the observations file is not there" in season.page.read_text("utf-8")


class Links(HTMLParser):
    """The links of a page, and whether it holds what it must not."""

    def __init__(self):
        super().__init__()
        self.links: list[str] = []
        self.tags: set[str] = set()

    def handle_starttag(self, tag, attrs):
        self.tags.add(tag)
        for name, value in attrs:
            if name in ("href", "src"):
                self.links.append(value or "")


def test_the_page_leads_to_each_report_and_nowhere_else(done):
    text = done.page.read_text("utf-8")
    seen = Links()
    seen.feed(text)
    assert seen.links == ["flight-0/report.html", "flight-1/report.html"]
    for link in seen.links:
        assert (done.page.parent / link).is_file()
    assert "script" not in seen.tags
    assert "default-src 'none'" in text


def test_page_and_table_only_change_with_what_they_say(done, obeyed):
    files = (done.page, done.table)
    times_ns = [file.stat().st_mtime_ns for file in files]
    obeyed("run", done.file)
    assert [file.stat().st_mtime_ns for file in files] == times_ns


@pytest.mark.parametrize("name", ["campaign.html", "campaign.parquet"])
def test_page_and_table_come_back(done, obeyed, name):
    """As after a run that was killed between the two: the other alone is known as ours."""
    files = (done.page, done.table)
    contents = [file.read_bytes() for file in files]
    done.page.with_name(name).unlink()
    obeyed("run", done.file)
    assert [file.read_bytes() for file in files] == contents


def test_the_table_agrees_with_the_manifests(done):
    for number, row in enumerate(done.rows()):
        results = done.manifest(number).parent
        points = pd.read_parquet(results / "observations")
        stations = pd.read_parquet(results / "stations.parquet")
        shift_x = points["x_corrected_px"] - points["x_px"]
        shift_y = points["y_corrected_px"] - points["y_px"]
        largest_px = np.hypot(shift_x, shift_y).max()
        assert row["shift_maximum_px"] == pytest.approx(largest_px, rel=1e-4)
        assert row["observations"] == row["corrected"] == len(points)
        assert row["fingerprint"] == done.values(number)["fingerprint"]
        begin = stations["time_utc"].min()
        assert row["begin_utc"].floor("s") == begin.floor("s")
        mean_deg = stations["lat_deg"].mean()
        assert row["lat_deg"] == pytest.approx(mean_deg, abs=1e-3)
    schema = pq.read_schema(done.table)
    assert schema.metadata[b"unbend.campaign"] == b"season"
    assert schema.field("sigma_px").metadata[b"unit"] == b"px"


def test_a_page_of_somebody_else_stays(season, unbend, refusal_of):
    season.page.parent.mkdir()
    season.page.write_text("my own page")
    refusal_of("STORAGE-NOT-OURS", 5, "run", season.file)
    assert season.page.read_text() == "my own page"
    assert unbend("status", season.file).code == 0  # it writes no page


@pytest.mark.parametrize(("content", "has_page"), [(b"my own table", True), (b"", False)])
def test_a_table_of_somebody_else_stays(done, refusal_of, content, has_page):
    if not has_page:
        done.page.unlink()
    done.table.write_bytes(content)
    refusal_of("STORAGE-NOT-OURS", 5, "run", done.file)
    assert done.table.read_bytes() == content


def test_code_and_summary_of_what_is_unchanged_are_those_of_the_run(done, obeyed):
    changed = done.values(0) | {"exit_code": 3}
    done.manifest(0).write_text(json.dumps(changed))
    done.older()
    first_alone = ("run", done.file, "--mission", "flight-0")
    compared = obeyed(*first_alone, "--verify-inputs", exit_code=3)
    assert done.unchanged() == [0, 1]

    unread = obeyed(*first_alone, exit_code=3)
    both = json.loads(
        obeyed(
            "run",
            done.file,
            "--json",
            exit_code=3,
        )
    )

    assert unread == compared
    assert "refraction of the air" in unread  # one mission alone has its summary
    assert [mission["exit_code"] for mission in both] == [3, 0]
    assert both[0]["manifest"] == changed


@pytest.mark.parametrize(
    "version",
    ["", "0.0.1"],
    ids=["damaged", "another version"],
)
def test_a_manifest_without_some_results_does_not_stop_the_others(done, obeyed, version):
    """One of another version, or damaged: the page says so, until the mission is run again."""
    values = done.values(0)
    del values["profile"]
    if version:
        values["versions"]["unbend"] = version
    done.manifest(0).write_text(json.dumps(values))
    obeyed("run", done.file, "--mission", "flight-1")
    assert done.states() == [("not run", "MANIFEST-UNREADABLE"), ("done", None)]

    obeyed("run", done.file, "--mission", "flight-0", "--force")
    assert done.states() == [("done", None), ("done", None)]


def test_what_is_unchanged_is_told_in_the_order_of_the_files(done, obeyed):
    """Also where the first mission was compared by its hashes, after the second was known."""
    sounding = done.flight(0) / "balloon.csv"
    sounding.touch()
    assert done.unchanged() == [1]
    text = obeyed("run", done.file)
    assert text.index("flight-0") < text.index("flight-1")

    sounding.touch()
    first, second = json.loads(obeyed("run", done.file, "--json"))
    assert Path(first["output"]).name == "flight-0"
    assert Path(second["output"]).name == "flight-1"
