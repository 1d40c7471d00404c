"""Campaigns: what runs and what does not, and how that is known; the page and the table."""

from __future__ import annotations

import json
import os
import shutil
import time
from dataclasses import dataclass
from html.parser import HTMLParser
from pathlib import Path

import pyarrow.parquet as pq
import pytest
import yaml

from tests.conftest import run_command, without_plots
from tests.stages.test_air_of_mission import sounding_text
from unbend.batch import input_files, unchanged
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

    def manifest(self, number: int) -> Path:
        return self.folder / "results" / f"flight-{number}" / "manifest.json"

    def older(self) -> None:
        """Files that were written some seconds ago; newer ones are not trusted."""
        settled_s = input_files.SETTLED_NS * 1e-9 + 0.05
        time.sleep(max(0.0, settled_s - (time.time() - self._latest())))

    def _latest(self) -> float:
        files = [file for file in self.folder.rglob("*") if not file.is_symlink()]
        return max(file.stat().st_ctime for file in files)

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
        own = {key: mission.config[key] for key in OWN}
        own["mission"] = own["mission"] | {"name": f"flight-{number}"}
        own["atmosphere"] = {"soundings": [{"path": "balloon.csv"}]}
        (flight / "balloon.csv").write_text(sounding_text(), encoding="utf-8")
        (flight / "mission.yaml").write_text(yaml.safe_dump(own), encoding="utf-8")
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
    assert (ended.code, ended.out.count("nothing to do")) == (0, 2)
    assert season.unchanged() == [0, 1]
    return season


def test_one_changed_sounding_runs_one_mission(done, unbend):
    before = [done.manifest(n).stat().st_mtime_ns for n in (0, 1)]
    (done.flight(1) / "balloon.csv").write_text(sounding_text(0.5), encoding="utf-8")
    first, second = json.loads(unbend("status", done.file, "--json").out)
    assert (first["would_run"], second["would_run"]) == (False, True)
    assert "sounding 1 changed (balloon.csv)" in str(second["reasons"])
    ran = unbend("run", done.file)
    assert ran.code == 0
    after = [done.manifest(n).stat().st_mtime_ns for n in (0, 1)]
    assert [a == b for a, b in zip(before, after, strict=True)] == [True, False]
    table = pq.read_table(done.folder / "results" / "campaign.parquet").to_pylist()
    assert [row["fingerprint"] for row in table] == [
        json.loads(done.manifest(n).read_text())["fingerprint"] for n in (0, 1)
    ]
    (line,) = [line for line in ran.out.splitlines() if "report.html" in line]
    assert line.startswith(f"{table[1]['mission']}: {table[1]['corrected']:,} of ")
    assert "95 % below " in line
    assert table[0]["shift_maximum_px"] != table[1]["shift_maximum_px"]  # another air


def test_of_an_unchanged_campaign_no_file_is_checked_and_no_input_opened(done, monkeypatch):
    monkeypatch.setattr(MissionRef, "load", lambda ref: pytest.fail(f"{ref.path} was checked"))
    monkeypatch.setattr(input_files, "hash_file", lambda path: pytest.fail(f"{path} was read"))
    assert done.unchanged() == [0, 1]


def append(file: Path, more: bytes) -> None:
    file.write_bytes(file.read_bytes() + more)


CHANGES = {
    "log": lambda s: append(s.flight(0) / "flight.bin", b"\0"),
    "log, its content": lambda s: flip(s.flight(0) / "flight.bin"),
    "table gone": lambda s: (s.flight(0) / "observations.parquet").unlink(),
    "mission file": lambda s: append(s.flight(0) / "mission.yaml", b"\n# a word\n"),
    "report gone": lambda s: (s.manifest(0).parent / "report.html").unlink(),
    "stations damaged": lambda s: flip(s.manifest(0).parent / "stations.parquet"),
    "part damaged": lambda s: flip(s.manifest(0).parent / "observations/part-00000.parquet"),
    "a part too many": lambda s: (s.manifest(0).parent / "observations/part-00009.parquet").touch(),
    "manifest gone": lambda s: s.manifest(0).unlink(),
    "a run under way": lambda s: (s.manifest(0).parent / ".staging").mkdir(),
    "results gone": lambda s: shutil.rmtree(s.manifest(0).parent),
}


def flip(file: Path) -> None:
    """Change one byte."""
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(content)


@pytest.mark.parametrize("what", CHANGES)
def test_no_change_goes_unseen(done, unbend, what):
    CHANGES[what](done)
    assert done.unchanged() == [1], what


def test_what_is_as_it_was_again_is_known_after_a_comparison(done, unbend):
    """Copied back, with times of its own; files of just now are not trusted."""
    log = done.flight(0) / "flight.bin"
    log.write_bytes(log.read_bytes())
    assert done.unchanged() == [1]
    assert unbend("run", done.file).code == 0
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
def test_asked_to_look_again_it_looks(done, unbend, monkeypatch, option):
    seen = []
    from unbend.batch import runs

    real = runs.make_plan
    monkeypatch.setattr(runs, "make_plan", lambda *a, **k: seen.append(k) or real(*a, **k))
    assert unbend("run", done.file, option, "--mission", "flight-0").code == 0
    assert len(seen) == 1


def test_a_mission_that_an_unchanged_one_shares_a_folder_with_is_refused(done, unbend, tmp_path):
    """Although the other is not run."""
    other = done.folder / "other.yaml"
    own = yaml.safe_load((done.flight(0) / "mission.yaml").read_text())
    own["log"]["path"] = own["observations"]["path"] = "nowhere"
    shared = yaml.safe_load(done.file.read_text())["defaults"]
    whole = shared | own | {"output": {"path": "results/flight-0"}}
    other.write_text(yaml.safe_dump(whole))
    ended = unbend("run", done.file, other)
    assert ended.code == 6
    assert "OUTPUT-SHARED" in ended.err


@pytest.mark.parametrize(
    ("key", "code"), [("mission", "CAMPAIGN-SAME-NAME"), ("output", "CAMPAIGN-SAME-OUTPUT")]
)
@pytest.mark.parametrize("command", ["run", "check", "status"])
def test_two_missions_of_one_are_refused_before_anything(season, unbend, key, code, command):
    for number in (0, 1):
        file = season.flight(number) / "mission.yaml"
        own = yaml.safe_load(file.read_text())
        own |= {"mission": {"name": "twin"}} if key == "mission" else {"output": {"path": "../r"}}
        file.write_text(yaml.safe_dump(own))
    before = sorted(season.folder.rglob("*"))
    ended = unbend(command, season.file)
    assert ended.code == 2
    assert code in ended.err
    assert ("twin" if key == "mission" else "flight-0 and flight-1") in ended.err
    assert sorted(season.folder.rglob("*")) == before


def test_one_mission_of_a_campaign_and_what_is_refused(season, unbend):
    assert "CAMPAIGN-MISSION" in unbend("run", season.file, "--mission", "flight-9").err
    (season.flight(1) / "observations.parquet").unlink()
    ended = unbend("run", season.file, "--mission", "flight-0")
    assert ended.code == 0, ended.text
    rows = pq.read_table(season.folder / "results" / "campaign.parquet").to_pylist()
    assert [row["state"] for row in rows] == ["done", "not run"]
    ended = unbend("run", season.file)
    assert ended.code == 6
    rows = pq.read_table(season.folder / "results" / "campaign.parquet").to_pylist()
    assert [(row["state"], row["code"]) for row in rows] == [
        ("done", None),
        ("refused", "INPUT-MISSING"),
    ]
    assert rows[1]["exit_code"] == 6
    page = (season.folder / "results" / "campaign.html").read_text(encoding="utf-8")
    assert "the observations file is not there" in page


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
    page = done.folder / "results" / "campaign.html"
    text = page.read_text(encoding="utf-8")
    seen = Links()
    seen.feed(text)
    assert seen.links == ["flight-0/report.html", "flight-1/report.html"]
    assert all((page.parent / link).is_file() for link in seen.links)
    assert "script" not in seen.tags
    assert "default-src 'none'" in text


def test_page_and_table_come_back_and_only_change_with_what_they_say(done, unbend):
    files = [done.folder / "results" / name for name in ("campaign.html", "campaign.parquet")]
    before = [(file.read_bytes(), file.stat().st_mtime_ns) for file in files]
    assert unbend("run", done.file).code == 0
    assert [(f.read_bytes(), f.stat().st_mtime_ns) for f in files] == before
    files[1].unlink()
    assert unbend("run", done.file).code == 0
    assert [f.read_bytes() for f in files] == [content for content, _ in before]


def test_the_table_agrees_with_the_manifests(done):
    table = pq.read_table(done.folder / "results" / "campaign.parquet")
    for number, row in enumerate(table.to_pylist()):
        manifest = json.loads(done.manifest(number).read_text())
        parts = pq.read_table(done.manifest(number).parent / "observations")
        shift = (
            (parts["x_corrected_px"].to_numpy() - parts["x_px"].to_numpy()) ** 2
            + (parts["y_corrected_px"].to_numpy() - parts["y_px"].to_numpy()) ** 2
        ) ** 0.5
        assert row["shift_maximum_px"] == pytest.approx(shift.max(), rel=1e-4)
        assert row["observations"] == row["corrected"] == parts.num_rows
        assert row["fingerprint"] == manifest["fingerprint"]
        stations = pq.read_table(done.manifest(number).parent / "stations.parquet")
        assert (
            row["begin_utc"].value // 10**9 == min(stations["time_utc"].to_pylist()).value // 10**9
        )
        assert row["lat_deg"] == pytest.approx(
            sum(stations["lat_deg"].to_pylist()) / len(stations), abs=1e-3
        )
    assert table.schema.metadata[b"unbend.campaign"] == b"season"
    assert table.schema.field("sigma_px").metadata[b"unit"] == b"px"


def test_a_page_of_somebody_else_stays(season, unbend):
    page = season.folder / "results" / "campaign.html"
    page.parent.mkdir()
    page.write_text("my own page")
    ended = unbend("run", season.file)
    assert (ended.code, page.read_text()) == (5, "my own page")
    assert "STORAGE-NOT-OURS" in ended.err
    assert unbend("status", season.file).code == 0  # it writes no page


def test_the_table_alone_is_known_as_ours(done, unbend):
    """As after a run that was killed between the two, or where a user removed the page."""
    page, table = (done.folder / "results" / f"campaign.{kind}" for kind in ("html", "parquet"))
    before = page.read_bytes()
    page.unlink()
    ended = unbend("run", done.file)
    assert (ended.code, page.read_bytes()) == (0, before), ended.text
    for other in (b"my own table", b""):
        page.unlink(missing_ok=True)
        table.write_bytes(other)
        ended = unbend("run", done.file)
        assert (ended.code, table.read_bytes()) == (5, other)
        assert "STORAGE-NOT-OURS" in ended.err


def test_code_and_summary_of_what_is_unchanged_are_those_of_the_run(done, unbend):
    told = json.loads(done.manifest(0).read_text()) | {"exit_code": 3}
    done.manifest(0).write_text(json.dumps(told))
    done.older()
    compared = unbend("run", done.file, "--mission", "flight-0", "--verify-inputs")
    assert done.unchanged() == [0, 1]
    known = unbend("run", done.file, "--mission", "flight-0")
    assert (known.code, known.out) == (compared.code, compared.out) == (3, known.out)
    assert "refraction of the air" in known.out  # one mission alone has its summary
    both = json.loads(unbend("run", done.file, "--json").out)
    assert [mission["exit_code"] for mission in both] == [3, 0]
    assert both[0]["manifest"] == told
    assert unbend("run", done.file).code == 3


@pytest.mark.parametrize("version", ["", "0.0.1"], ids=["damaged", "another version"])
def test_a_manifest_without_some_results_does_not_stop_the_others(done, unbend, version):
    """One of another version, or damaged: the page says so, until the mission is run again."""
    values = json.loads(done.manifest(0).read_text())
    del values["profile"]
    if version:
        values["versions"]["unbend"] = version
    done.manifest(0).write_text(json.dumps(values))
    table = done.folder / "results" / "campaign.parquet"
    ended = unbend("run", done.file, "--mission", "flight-1")
    assert ended.code == 0, ended.text
    first, second = pq.read_table(table).to_pylist()
    assert (first["state"], first["code"]) == ("not run", "MANIFEST-UNREADABLE")
    assert second["state"] == "done"
    ended = unbend("run", done.file, "--mission", "flight-0", "--force")
    assert ended.code == 0, ended.text
    assert pq.read_table(table).to_pylist()[0]["state"] == "done"


def test_what_is_unchanged_is_told_in_the_order_of_the_files(done, unbend):
    """Also where the first mission was compared by its hashes, after the second was known."""
    (done.flight(0) / "balloon.csv").touch()
    assert done.unchanged() == [1]
    told = unbend("run", done.file).out
    assert told.index("flight-0") < told.index("flight-1")
    (done.flight(0) / "balloon.csv").touch()
    entries = json.loads(unbend("run", done.file, "--json").out)
    names = [Path(entry["output"]).name for entry in entries]
    assert names == ["flight-0", "flight-1"]
