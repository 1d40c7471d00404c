"""Every command as a person meets it: help, words, numbers, exit codes, eighty columns."""

from __future__ import annotations

import csv
import json
import math
import os
import re
import subprocess
import sys

import pyarrow.parquet as pq
import pytest

from unbend import __version__
from unbend.cli.app import GROUPS
from unbend.ingest.flight_log import Log
from unbend.refraction import angle

pytestmark = pytest.mark.usefixtures("eighty_columns")

COMMANDS = (
    "init",
    "check",
    "run",
    "export",
    "status",
    "report",
    "verify",
    "stations",
    "inspect",
    "profile",
    "angle",
    "tables",
    "simulate",
    "help",
    "schema",
    "warm",
)


@pytest.fixture(autouse=True)
def eighty_columns(monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("LINES", "25")


def longest(text: str) -> int:
    return max(len(line.rstrip()) for line in text.splitlines())


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_help_with_an_example(unbend, command):
    ended = unbend(command, "--help")
    assert ended.code == 0
    assert re.search(rf"Example: unbend {command}[ ;]", ended.out)
    assert longest(ended.out) <= 80
    assert command in unbend("--help").out


def test_the_help_is_the_manual(unbend):
    text = unbend("--help").out
    assert "Exit codes: 0 done; 1 a bug; 2 command or mission file" in text
    assert longest(text) <= 80
    listed = []
    for group in GROUPS:
        listed += text.partition(f"{group}:\n")[2].partition("\n\n")[0].splitlines()
    assert tuple(line.split()[0] for line in listed) == COMMANDS
    assert all(line.endswith(".") and not line.endswith("..") for line in listed)


def test_an_example_on_two_lines_can_be_pasted(unbend):
    shown = unbend("angle", "--help").out.partition("Example: unbend ")[2]
    for example in shown.split("or: unbend "):
        assert unbend(*example.replace("\\\n", " ").split()).code == 0


def test_version(unbend):
    assert unbend("--version").out == f"unbend {__version__}\n"
    assert unbend("--version").code == 0


@pytest.mark.parametrize(
    "words",
    [
        (),
        ("fly",),
        ("run",),
        ("check",),
        ("inspect",),
        ("verify",),
        ("run", "--fast", "a.yaml"),
        ("run", "a.yaml", "--jobs", "0"),
        ("run", "a.yaml", "--jobs", "two"),
        ("--verbose",),
        ("angle", "--camera-height", "high", "--ground-height", "0", "--nadir-angle", "1"),
        ("angle", "--camera-height", "1"),
        ("inspect", "a.bin", "b.bin"),
        ("simulate",),
    ],
    ids=" ".join,
)
def test_a_command_that_cannot_be_obeyed(unbend, words):
    ended = unbend(*words)
    assert ended.code == 2
    assert "Usage: unbend" in ended.text
    assert "Traceback" not in ended.text


ANGLES = {
    (10000, 0, 75): 61.778543, (10000, 0, 45): 16.378452, (3000, 0, 45): 7.088778,
    (120, 0, 45): 0.327323, (20000, 0, 85): 327.014637,
}  # fmt: skip


@pytest.mark.parametrize("at", ANGLES, ids=str)
def test_angle(unbend, at):
    words = (
        "angle",
        "--atmosphere",
        "us1976",
        "--index",
        "gyer",
        "--radius",
        "6371000",
        "--camera-height",
        at[0],
        "--ground-height",
        at[1],
        "--nadir-angle",
        at[2],
    )
    plain = unbend(*words)
    as_json = unbend(*words, "--json")
    assert plain.code == as_json.code == 0
    found = json.loads(as_json.out)
    assert found["r_c_arcsec"] == pytest.approx(ANGLES[at], abs=1e-6)
    assert found["r_c_urad"] == pytest.approx(found["r_c_arcsec"] * 4.84813681109536, rel=1e-12)
    assert found["ground_m"] > 0.0
    assert f"{found['r_c_arcsec']:.5g} arcsec" in plain.out
    assert "microradians" in plain.out


def strict(text: str) -> dict:
    """JSON as its standard has it: NaN and Infinity are no numbers."""

    def refuse(word: str) -> None:
        raise AssertionError(f"{word} is no JSON")

    return json.loads(text, parse_constant=refuse)


def words_of(h_c: float, h_g: float, zeta: float, *others: object) -> tuple[object, ...]:
    return ("angle", "--camera-height", h_c, "--ground-height", h_g, "--nadir-angle", zeta, *others)


def test_an_angle_over_the_horizon_has_no_metres(unbend):
    """asin(6371 / 6381) is 86.792 degrees: there the straight ray misses, the bent one lands."""
    found = strict(unbend(*words_of(10_000, 0, 86.8), "--json").out)
    assert (found["ground_m"], found["status"]) == (None, "ok")
    assert found["r_c_arcsec"] > 470.0
    plain = unbend(*words_of(10_000, 0, 86.8))
    assert plain.code == 0
    assert "nan" not in plain.out.lower()
    assert "None" not in plain.out
    said = " ".join(plain.out.split())
    assert "no metres on the ground: the straight ray in the apparent direction is above" in said
    assert longest(plain.out) <= 80
    near = strict(unbend(*words_of(10_000, 0, 86.79), "--json").out)
    assert near["ground_m"] > 0.0
    assert "no metres" not in unbend(*words_of(10_000, 0, 86.79)).out


# From 3 km the ray at 88.4 degrees has 1000 m twice, some 92 and 328 km away.
CROSSINGS = {None: "beyond_grazing", 80_000: "ok", 340_000: "far_branch"}


def landing(zeta: float, *, far: bool) -> tuple[float, float]:
    """East and up of where a straight line from 3 km enters, or leaves, the sphere at 1 km [m]."""
    r_c = 6_374_000.0
    r_g = 6_372_000.0
    half = math.sqrt((r_c * math.cos(zeta)) ** 2 - (r_c - r_g) * (r_c + r_g))
    s = r_c * math.cos(zeta) + (half if far else -half)
    return s * math.sin(zeta), -s * math.cos(zeta)


@pytest.mark.parametrize("distance", CROSSINGS)
def test_the_slant_range_chooses_the_crossing(unbend, distance):
    others = () if distance is None else ("--distance", distance)
    ray = words_of(3000, 1000, 88.4, *others)
    found = strict(unbend(*ray, "--json").out)
    plain = unbend(*ray)
    assert found["status"] == CROSSINGS[distance]
    assert found["distance_m"] == distance
    near = strict(unbend(*words_of(3000, 1000, 88.4), "--json").out)
    assert (found["r_c_arcsec"] == near["r_c_arcsec"]) == (distance != 340_000)
    zeta = math.radians(88.4)
    there = [landing(zeta - r, far=distance == 340_000) for r in (0.0, found["r_c_rad"])]
    assert found["ground_m"] == pytest.approx(math.dist(*there), rel=1e-8)
    said = " ".join(plain.out.split())
    assert longest(plain.out) <= 80
    assert ("the near one of two crossings" in said) == (distance is None)
    assert ("the far one of two crossings" in said) == (distance == 340_000)
    assert "None" not in said


@pytest.mark.parametrize("command", ["angle", "inspect"])
def test_what_is_no_json_is_never_printed_as_json(unbend, flown, monkeypatch, command):
    """Whatever slips through is a bug that shows, not a file that only Python can read."""
    monkeypatch.setattr(angle, "one_angle", lambda **_: {"ground_m": math.nan})
    monkeypatch.setattr(Log, "to_json_dict", lambda _: {"duration_s": math.inf})
    words = words_of(3000, 0, 45) if command == "angle" else ("inspect", flown.logs["mcap"])
    with pytest.raises(ValueError, match="JSON"):
        unbend(*words, "--json")


def test_an_ordinary_angle_says_nothing_of_crossings(unbend):
    found = strict(unbend(*words_of(3000, 0, 45), "--json").out)
    assert (found["status"], found["distance_m"]) == ("ok", None)
    assert "crossing" not in unbend(*words_of(3000, 0, 45)).out


@pytest.mark.parametrize("method", ["spherical", "plane", "gyer1996", "manual"])
@pytest.mark.parametrize(
    ("option", "value", "code"),
    [
        ("--radius", "nan", "RAY-BAD-MEASUREMENT"),
        ("--radius", "inf", "RAY-BAD-MEASUREMENT"),
        ("--radius", "0", "RAY-BAD-MEASUREMENT"),
        ("--camera-height", "inf", "RAY-BAD-MEASUREMENT"),
        ("--ground-height", "-inf", "RAY-BAD-MEASUREMENT"),
        ("--distance", "-1", "ANGLE-DISTANCE"),
        ("--distance", "nan", "ANGLE-DISTANCE"),
        ("--distance", "0", "ANGLE-DISTANCE"),
    ],
)
def test_an_angle_of_what_is_no_number(unbend, method, option, value, code):
    words = {"--camera-height": "3000", "--ground-height": "0", "--nadir-angle": "45"}
    words |= {"--method": method, option: value}
    ended = unbend("angle", "--json", *(f"{name}={text}" for name, text in words.items()))
    assert (ended.code, ended.out) == (2, "")
    assert ended.err.startswith(f"{code}: ")


def test_heights_outside_the_profile_are_refused_at_once(unbend):
    for h_c, h_g in ((1e15, 0), (3000, -1e15)):
        words = words_of(h_c, h_g, 45, "--method", "gyer1996")
        ended = unbend(*words[:3], f"--ground-height={h_g}", *words[5:])
        assert ended.code == 2
        assert ended.err.startswith("RAY-OUTSIDE-PROFILE: ")


@pytest.mark.parametrize(
    ("option", "value", "code"),
    [
        ("--atmosphere", "us1967", "ATMOSPHERE-NAME"),
        ("--method", "magic", "METHOD-NAME"),
        ("--index", "edlen", "AIR-INDEX"),
        ("--nadir-angle", "200", "RAY-BAD-MEASUREMENT"),
        ("--camera-height", "nan", "RAY-BAD-MEASUREMENT"),
        ("--camera-height", "1e9", "RAY-OUTSIDE-PROFILE"),
        ("--nadir-angle", "120", "RAY-MISSES-GROUND"),
    ],
)
def test_an_angle_that_does_not_exist(unbend, option, value, code):
    words = {"--camera-height": "3000", "--ground-height": "0", "--nadir-angle": "45"}
    words[option] = value
    ended = unbend("angle", *(word for pair in words.items() for word in pair))
    assert ended.code == 2
    assert ended.err.startswith(f"{code}: ")
    assert "to do: " in ended.err


KEYS = {"format", "messages", "bad_bytes", "lost_messages", "boots", "channels", "duration_s"}


@pytest.mark.parametrize("kind", ["bin", "tlog", "mcap"])
def test_inspect(unbend, flown, kind):
    plain = unbend("inspect", flown.logs[kind])
    as_json = unbend("inspect", flown.logs[kind], "--json")
    assert plain.code == as_json.code == 0
    assert longest(plain.out) <= 80
    assert "rate [Hz]" in plain.out
    found = json.loads(as_json.out)
    assert set(found) >= KEYS
    assert sum(found["messages"].values()) == flown.messages[kind]
    assert found["boots"] == 1
    assert found["bad_bytes"] == found["lost_messages"] == 0
    assert found["duration_s"] == pytest.approx(flown.duration_s, abs=30.0)
    for channel in found["channels"]:
        assert channel["name"] in plain.out


def test_inspect_speaks_the_words_of_the_mission_file(unbend, flown, baseline):
    found = json.loads(unbend("inspect", flown.logs["bin"], "--json").out)
    names = {channel["name"] for channel in found["channels"]}
    assert set(baseline.config["log"]["channels"].values()) <= names
    assert {e["channel"] for e in baseline.config["events"]["log"].values()} <= names


def test_inspect_of_what_is_no_log(unbend, tmp_path):
    ended = unbend("inspect", tmp_path / "none.bin")
    assert ended.code == 6
    assert ended.err.startswith("LOG-MISSING: ")


def test_inspect_of_a_cut_log_ends_with_the_code_of_losses(unbend, flown, tmp_path):
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(flown.logs["mcap"].read_bytes()[:-5000])
    ended = unbend("inspect", cut)
    assert ended.code == 3
    assert "loss LOG-" in ended.out


def test_check_says_what_it_understood_and_writes_nothing(unbend, mission):
    before = sorted(p.name for p in mission.folder.iterdir())
    ended = unbend("check", mission.save())
    assert ended.code == 0
    for words in (
        "can be run",
        "3 of nadir, 3 of oblique",
        "59 in 6 images",
        "BARO[0]",
        "dataflash",
    ):
        assert words in ended.out
    assert sorted(p.name for p in mission.folder.iterdir()) == sorted([*before, "mission.yaml"])
    mission.config["log"]["channels"]["humidity"] = "HYGR[9]"
    ended = unbend("check", mission.save())
    assert ended.code == 3
    assert "CHANNEL-MISSING" in ended.out
    mission.config["log"]["path"] = "none.bin"
    ended = unbend("check", mission.save())
    assert ended.code == 6
    assert "INPUT-MISSING" in ended.err


def test_brackets_in_a_path_are_no_markup(unbend, mission_factory, tmp_path):
    mission = mission_factory(tmp_path / "[bold]strip[1]")
    assert "[bold]strip[1]" in re.sub(r"\n\s*", "", unbend("check", mission.save()).out)


def test_summary_of_a_run(baseline):
    ended = baseline.run()
    assert ended.code == 0
    assert ended.err == ""
    assert "All 59 observations were corrected" in ended.out
    text = " ".join(ended.out.split())
    for words in ("cm on the ground, ", "px in the image (median; ", "[px]", "[arcsec]", "results"):
        assert words in text
    paths = [line for line in ended.out.splitlines() if str(baseline.folder) in line]
    assert len(paths) == 2  # in one piece
    assert longest("\n".join(set(ended.out.splitlines()) - set(paths))) <= 80


def test_profile_of_a_standard(unbend, tmp_path):
    ended = unbend("profile", "--atmosphere", "us1976")
    assert ended.code == 0
    assert longest(ended.out) <= 80
    assert "(n-1)e6; std is us1976 at the same height" in ended.out
    ground = [line.split() for line in ended.out.splitlines() if line.startswith("    0 ")]
    assert ground == [
        ["0", *["288.15"] * 2, *["1013.2"] * 2, *["0.00"] * 2, *["277.84"] * 2, "standard"]
    ]
    target = tmp_path / "air.csv"
    assert unbend("profile", "--atmosphere", "us1976", "--csv", target).code == 0
    with target.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    ground = min(rows, key=lambda row: abs(float(row["h_m"])))
    assert float(ground["temperature_k"]) == pytest.approx(288.15, abs=2.0)
    for name in ("temperature_k", "pressure_pa", "vapour_pressure_pa", "refractivity"):
        assert [row[f"standard_{name}"] for row in rows] == [row[name] for row in rows]
    isothermal = [r for r in rows if r["equation"] == "53" and float(r["h_m"]) < 21_000]
    assert isothermal
    for row in isothermal:
        assert float(row["temperature_k"]) == pytest.approx(216.65, abs=1e-9)


def test_profile_of_a_mission(unbend, mission, baseline, tmp_path):
    target = tmp_path / "air.csv"
    plot = tmp_path / "air.png"
    ended = unbend("profile", mission.save(), "--csv", target, "--plot", plot)
    assert ended.code == 0
    said = " ".join(ended.out.split())
    for words in ("R at 45° from", "HYGR[0]: temperature", "note AIR-ANCHOR"):
        assert words in said
    assert ended.out.splitlines()[-2:] == [str(target), str(plot)]
    assert "source" not in ended.out.splitlines()[0]
    assert plot.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    with target.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    written = pq.read_table(baseline.output / "profile.parquet")
    assert [float(row["pressure_pa"]) for row in rows] == written["pressure_pa"].to_pylist()
    assert not mission.output.exists()
    standard = [float(row["standard_refractivity"]) for row in rows]
    # Of US 1976 at 15 degC and 1013.25 hPa: 277.84e-6 (Ciddor 1996, 0.55 um).
    at_sea = min(range(len(rows)), key=lambda i: abs(float(rows[i]["h_m"])))
    assert standard[at_sea] == pytest.approx(2.778e-4, rel=0.01)
    assert all(float(row["standard_vapour_pressure_pa"]) == 0.0 for row in rows)


def test_a_profile_that_lost_something_says_so_beside_its_plot(unbend, mission, tmp_path):
    mission.config["log"]["channels"]["temperature"] = "HYGR[7]"
    ended = unbend("profile", mission.save(), "--csv", tmp_path / "air.csv")
    assert ended.code == 3, ended.text
    assert "loss CHANNEL-MISSING" in ended.out
    assert str(tmp_path / "air.csv") in ended.out


@pytest.mark.parametrize(
    ("words", "code", "exit_code"),
    [
        ((), "PROFILE-ARGUMENTS", 2),
        (("a.yaml", "--atmosphere", "us1976"), "PROFILE-ARGUMENTS", 2),
        (("a.yaml",), "CONFIG-MISSING", 2),
        (("--atmosphere", "mars"), "ATMOSPHERE-NAME", 2),
        (("--atmosphere", "us1976", "--plot", "air.pdf"), "PLOT-FORMAT", 2),
        (("--atmosphere", "us1976", "--csv", "none/air.csv"), "STORAGE-WRITE", 5),
        (("--atmosphere", "us1976", "--plot", "none/air.png"), "STORAGE-WRITE", 5),
    ],
)
def test_a_profile_that_cannot_be_had(unbend, words, code, exit_code, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    ended = unbend("profile", *words)
    assert ended.code == exit_code
    assert ended.err.startswith(f"{code}: ")


def test_a_flight_that_cannot_be_simulated(unbend, tmp_path):
    ended = unbend("simulate", tmp_path / "flown", "--height", "-5")
    assert ended.code == 2
    assert ended.err.startswith("SIM-OPTION: ")


def test_interrupted(unbend, monkeypatch):
    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(angle, "one_angle", interrupt)
    words = ("angle", "--camera-height", 1, "--ground-height", 0, "--nadir-angle", 0)
    ended = unbend(*words)
    assert ended.code == 130
    assert "interrupted" in ended.err


def test_names_outside_the_code_page_of_the_console_are_escaped(tmp_path):
    """A redirected console on Windows has code page 1252; this is Python's way to have it here."""
    done = subprocess.run(
        [sys.executable, "-m", "unbend", "profile", "--atmosphere", "us1976", "--csv", "\u03a9"],
        capture_output=True,
        cwd=tmp_path,
        env=os.environ | {"PYTHONIOENCODING": "cp1252"},
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == b"\\u03a9"
    assert (tmp_path / "\u03a9").is_file()
