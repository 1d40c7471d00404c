"""Campaigns: what runs and what does not, and how that is known; the page and the table."""

from __future__ import annotations

import json
import os
import shutil
import time
from dataclasses import dataclass
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
import yaml

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
    def file(self) -> Path:
        return self.folder / "season.yaml"

    def flight(self, number: int) -> Path:
        return self.folder / "flights" / f"f{number}"

    @property
    def table(self) -> Path:
        return self.folder / "results" / "campaign.parquet"

    @property
    def page(self) -> Path:
        return self.folder / "results" / "campaign.html"

    def manifest(self, number: int) -> Path:
        return self.folder / "results" / f"flight-{number}" / "manifest.json"

    def values(self, number: int) -> dict[str, Any]:
        """The manifest of a mission as JSON."""
        return json.loads(self.manifest(number).read_text())

    def rows(self) -> list[dict[str, Any]]:
        """The rows of the table."""
        return pq.read_table(self.table).to_pylist()

    def older(self) -> None:
        """Files that were written some seconds ago; newer ones are not trusted."""
        files = [file for file in self.folder.rglob("*") if not file.is_symlink()]
        latest = max(file.stat().st_ctime for file in files)
        settled_s = input_files.SETTLED_NS * 1e-9 + 0.05
        time.sleep(max(0.0, latest + settled_s - time.time()))

    def unchanged(self) -> list[int]:
        """Numbers of the missions that are known to be unchanged without checking their files."""
        chosen = select_missions([self.file])
        return [n for n, ref in enumerate(chosen.missions) if chosen.is_unchanged(ref)]


def make_season(mission, folder: Path, missions: int) -> Season:
    season = Season(folder)
    for number in range(missions):
        flight = season.flight(number)
        flight.mkdir(parents=True)
        shutil.copy(mission.log, flight / "flight.bin")
        shutil.copy(mission.folder / "observations.parquet", flight)
        sections = {key: mission.config[key] for key in OWN}
        sections["mission"] = sections["mission"] | {"name": f"flight-{number}"}
        sections["atmosphere"] = {"soundings": [{"path": "balloon.csv"}]}
        (flight / "balloon.csv").write_text(sounding_text(), encoding="utf-8")
        (flight / "mission.yaml").write_text(yaml.safe_dump(sections), encoding="utf-8")
    shared = {k: v for k, v in mission.config.items() if k not in (*OWN, "output")}
    content = {
        "campaign": {"name": "season", "output": "results"},
        "defaults": shared,
        "missions": ["flights/*/mission.yaml"],
    }
    season.file.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    return season


@pytest.fixture
def own_cache(tmp_path, monkeypatch):
    """A user's cache of the test's own, empty; a file settles in 0.2 s."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(input_files, "SETTLED_NS", 200_000_000)


@pytest.fixture
def season(mission, tmp_path, own_cache, plain_report) -> Season:
    return make_season(mission, tmp_path / "season", 2)


@pytest.fixture(scope="module")
def finished(mission_factory, tmp_path_factory, computed_once) -> Season:
    """A campaign that ran. Not to be changed."""
    folder = tmp_path_factory.mktemp("campaign")
    ran = make_season(mission_factory(folder / "mission"), folder / "season", 2)
    with without_plots():
        ended = run_command("run", ran.file)
    assert ended.code == 0, ended.text
    return ran


@pytest.fixture
def done(finished, tmp_path, own_cache, plain_report, unbend) -> Season:
    """A copy of a campaign that ran, whose manifests know its files."""
    season = Season(tmp_path / "season")
    shutil.copytree(finished.folder, season.folder)
    season.older()
    ended = unbend("run", season.file)  # it lies elsewhere, and is the same
    assert ended.code == 0
    assert ended.out.count("nothing to do") == 2
    assert season.unchanged() == [0, 1]
    return season


def test_one_changed_sounding_runs_one_mission(done, unbend, obeyed):
    before = [done.manifest(number).stat().st_mtime_ns for number in (0, 1)]
    (done.flight(1) / "balloon.csv").write_text(sounding_text(0.5), encoding="utf-8")
    first, second = json.loads(unbend("status", done.file, "--json").out)
    assert not first["would_run"]
    assert second["would_run"]
    assert "sounding 1 changed (balloon.csv)" in str(second["reasons"])
    text = obeyed("run", done.file)
    assert done.manifest(0).stat().st_mtime_ns == before[0]
    assert done.manifest(1).stat().st_mtime_ns != before[1]
    rows = done.rows()
    for number, row in enumerate(rows):
        assert row["fingerprint"] == done.values(number)["fingerprint"]
    (line,) = [line for line in text.splitlines() if "report.html" in line]
    assert line.startswith(f"{rows[1]['mission']}: {rows[1]['corrected']:,} of ")
    assert "95 % below " in line
    assert rows[0]["shift_maximum_px"] != rows[1]["shift_maximum_px"]  # another air


def test_of_an_unchanged_campaign_no_file_is_checked_and_no_input_opened(done, monkeypatch):
    monkeypatch.setattr(MissionRef, "load", lambda ref: pytest.fail(f"{ref.path} was checked"))
    monkeypatch.setattr(input_files, "hash_file", lambda path: pytest.fail(f"{path} was read"))
    assert done.unchanged() == [0, 1]


def append(file: Path) -> None:
    file.write_bytes(file.read_bytes() + b"\n")


def flip(file: Path) -> None:
    """Change one byte."""
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(content)


@pytest.mark.parametrize(
    ("path", "change"),
    [
        ("flights/f0/flight.bin", append),
        ("flights/f0/flight.bin", flip),
        ("flights/f0/observations.parquet", Path.unlink),
        ("flights/f0/mission.yaml", append),
        ("results/flight-0/report.html", Path.unlink),
        ("results/flight-0/stations.parquet", flip),
        ("results/flight-0/observations/part-00000.parquet", flip),
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
    past = time.time() - 60
    os.utime(raster, (past, past))
    named = input_files.NamedInput("geoid", "mission.geoid", "geoid.tif", input_files.GDAL)

    def record_now():
        files = input_files.files_of(raster, input_files.GDAL)
        states = tuple(input_files.state_of(file)._replace(ctime_ns=0) for file in files)
        return input_files.record_of(named, files, states)

    before = record_now()
    assert before.mtime_ns is not None
    (tmp_path / "geoid.tif.aux.xml").write_text("<PAMDataset/>")
    assert not record_now().is_like(before)


def test_another_program_knows_nothing(done, monkeypatch):
    monkeypatch.setattr(unchanged, "versions_of", lambda roles, standard: {"unbend": "other"})
    assert done.unchanged() == []


def test_other_defaults_are_other_missions(done):
    text = done.file.read_text()
    done.file.write_text(text.replace("reference: msl", "reference: msl\n    sigma_m: 0.5"))
    assert done.unchanged() == []
    done.file.write_text(text)
    assert done.unchanged() == [0, 1]


@pytest.mark.parametrize("option", ["--force", "--verify-inputs"])
def test_asked_to_look_again_it_looks(done, obeyed, monkeypatch, option):
    plans = []
    make_plan = runs.make_plan
    monkeypatch.setattr(runs, "make_plan", lambda *a, **k: plans.append(k) or make_plan(*a, **k))
    obeyed("run", done.file, option, "--mission", "flight-0")
    assert len(plans) == 1


def test_a_mission_that_an_unchanged_one_shares_a_folder_with_is_refused(done, refusal_of):
    """Although the other is not run."""
    whole = yaml.safe_load(done.file.read_text())["defaults"]
    whole |= yaml.safe_load((done.flight(0) / "mission.yaml").read_text())
    whole["log"]["path"] = whole["observations"]["path"] = "nowhere"
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
        file = season.flight(number) / "mission.yaml"
        file.write_text(yaml.safe_dump(yaml.safe_load(file.read_text()) | section))
    before = set(season.folder.rglob("*"))
    text = refusal_of(code, 2, command, season.file)
    assert words in text
    assert set(season.folder.rglob("*")) == before


def test_one_mission_of_a_campaign_and_what_is_refused(season, unbend, obeyed):
    assert "CAMPAIGN-MISSION" in unbend("run", season.file, "--mission", "flight-9").err
    (season.flight(1) / "observations.parquet").unlink()
    obeyed("run", season.file, "--mission", "flight-0")
    assert [row["state"] for row in season.rows()] == ["done", "not run"]
    obeyed("run", season.file, exit_code=6)
    done, refused = season.rows()
    assert (done["state"], done["code"]) == ("done", None)
    assert (refused["state"], refused["code"]) == ("refused", "INPUT-MISSING")
    assert refused["exit_code"] == 6
    assert "the observations file is not there" in season.page.read_text(encoding="utf-8")


class Links(HTMLParser):
    """The links of a page, and whether it holds what it must not."""

    def __init__(self) -> None:
        super().__init__()
        self.links: list[str] = []
        self.tags: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        self.links += [value or "" for name, value in attrs if name in ("href", "src")]


def test_the_page_leads_to_each_report_and_nowhere_else(done):
    text = done.page.read_text(encoding="utf-8")
    seen = Links()
    seen.feed(text)
    assert seen.links == ["flight-0/report.html", "flight-1/report.html"]
    for link in seen.links:
        assert (done.page.parent / link).is_file()
    assert "script" not in seen.tags
    assert "default-src 'none'" in text


def test_page_and_table_come_back_and_only_change_with_what_they_say(done, obeyed):
    page = done.page.read_bytes()
    table = done.table.read_bytes()
    times = (done.page.stat().st_mtime_ns, done.table.stat().st_mtime_ns)
    obeyed("run", done.file)
    assert (done.page.stat().st_mtime_ns, done.table.stat().st_mtime_ns) == times
    done.table.unlink()
    obeyed("run", done.file)
    assert done.page.read_bytes() == page
    assert done.table.read_bytes() == table


def test_the_table_agrees_with_the_manifests(done):
    for number, row in enumerate(done.rows()):
        results = done.manifest(number).parent
        points = pd.read_parquet(results / "observations")
        stations = pd.read_parquet(results / "stations.parquet")
        shift_x = points["x_corrected_px"] - points["x_px"]
        shift_y = points["y_corrected_px"] - points["y_px"]
        assert row["shift_maximum_px"] == pytest.approx(np.hypot(shift_x, shift_y).max(), rel=1e-4)
        assert row["observations"] == row["corrected"] == len(points)
        assert row["fingerprint"] == done.values(number)["fingerprint"]
        assert row["begin_utc"].floor("s") == stations["time_utc"].min().floor("s")
        assert row["lat_deg"] == pytest.approx(stations["lat_deg"].mean(), abs=1e-3)
    schema = pq.read_schema(done.table)
    assert schema.metadata[b"unbend.campaign"] == b"season"
    assert schema.field("sigma_px").metadata[b"unit"] == b"px"


def test_a_page_of_somebody_else_stays(season, unbend, refusal_of):
    season.page.parent.mkdir()
    season.page.write_text("my own page")
    refusal_of("STORAGE-NOT-OURS", 5, "run", season.file)
    assert season.page.read_text() == "my own page"
    assert unbend("status", season.file).code == 0  # it writes no page


def test_the_table_alone_is_known_as_ours(done, obeyed):
    """As after a run that was killed between the two, or where a user removed the page."""
    before = done.page.read_bytes()
    done.page.unlink()
    obeyed("run", done.file)
    assert done.page.read_bytes() == before


@pytest.mark.parametrize("content", [b"my own table", b""])
def test_a_table_of_somebody_else_stays(done, refusal_of, content):
    done.page.unlink()
    done.table.write_bytes(content)
    refusal_of("STORAGE-NOT-OURS", 5, "run", done.file)
    assert done.table.read_bytes() == content


def test_code_and_summary_of_what_is_unchanged_are_those_of_the_run(done, unbend, obeyed):
    changed = done.values(0) | {"exit_code": 3}
    done.manifest(0).write_text(json.dumps(changed))
    done.older()
    compared = unbend("run", done.file, "--mission", "flight-0", "--verify-inputs")
    assert done.unchanged() == [0, 1]
    unread = unbend("run", done.file, "--mission", "flight-0")
    assert unread.code == compared.code == 3
    assert unread.out == compared.out
    assert "refraction of the air" in unread.out  # one mission alone has its summary
    both = json.loads(unbend("run", done.file, "--json").out)
    assert [mission["exit_code"] for mission in both] == [3, 0]
    assert both[0]["manifest"] == changed
    obeyed("run", done.file, exit_code=3)


@pytest.mark.parametrize("version", ["", "0.0.1"], ids=["damaged", "another version"])
def test_a_manifest_without_some_results_does_not_stop_the_others(done, obeyed, version):
    """One of another version, or damaged: the page says so, until the mission is run again."""
    values = done.values(0)
    del values["profile"]
    if version:
        values["versions"]["unbend"] = version
    done.manifest(0).write_text(json.dumps(values))
    obeyed("run", done.file, "--mission", "flight-1")
    first, second = done.rows()
    assert (first["state"], first["code"]) == ("not run", "MANIFEST-UNREADABLE")
    assert second["state"] == "done"
    obeyed("run", done.file, "--mission", "flight-0", "--force")
    assert done.rows()[0]["state"] == "done"


def test_what_is_unchanged_is_told_in_the_order_of_the_files(done, unbend):
    """Also where the first mission was compared by its hashes, after the second was known."""
    (done.flight(0) / "balloon.csv").touch()
    assert done.unchanged() == [1]
    text = unbend("run", done.file).out
    assert text.index("flight-0") < text.index("flight-1")
    (done.flight(0) / "balloon.csv").touch()
    entries = json.loads(unbend("run", done.file, "--json").out)
    names = [Path(entry["output"]).name for entry in entries]
    assert names == ["flight-0", "flight-1"]
