"""Every command as a person meets it: help, words, numbers, exit codes, eighty columns."""

import json
import math
import os
import re
import subprocess
import sys

import pandas as pd
import pytest
import yaml

from tests.helpers import one_line
from tests.refraction.straight_lines import metres_apart
from unbend import __version__
from unbend.cli.app import GROUPS
from unbend.ingest import open_log
from unbend.ingest.flight_log import Log
from unbend.refraction import angle

from .printed import longest, strict_json

pytestmark = pytest.mark.usefixtures("eighty_columns")

NAMES = """
    init check run export status report verify stations
    inspect profile angle tables simulate help schema warm
"""
COMMANDS = NAMES.split()


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_help_with_an_example(unbend, command, obeyed):
    text = obeyed(command, "--help")
    assert re.search(rf"Example: unbend {command}[ ;]", text)
    assert longest(text) <= 80
    assert command in unbend("--help").out


def test_the_help_is_the_manual(unbend):
    text = unbend("--help").out
    assert "Exit codes: 0 done; 1 a bug; 2 command or mission file" in text
    assert longest(text) <= 80
    lines = []
    for group in GROUPS:
        section = text.partition(f"{group}:\n")[2]
        lines += section.partition("\n\n")[0].splitlines()
    assert [line.split()[0] for line in lines] == COMMANDS
    for line in lines:
        assert line.endswith(".")
        assert not line.endswith("..")


def test_an_example_on_two_lines_can_be_pasted(unbend, obeyed):
    shown = unbend("angle", "--help").out.partition("Example: unbend ")[2]
    for example in shown.split("or: unbend "):
        obeyed(*example.replace("\\\n", " ").split())


def test_version(obeyed):
    assert obeyed("--version") == f"unbend {__version__}\n"


@pytest.mark.parametrize(
    "words",
    [
        "",
        "fly",
        "run",
        "check",
        "inspect",
        "verify",
        "run --fast a.yaml",
        "run a.yaml --jobs 0",
        "run a.yaml --jobs two",
        "--verbose",
        "angle --camera-height high --ground-height 0 --nadir-angle 1",
        "angle --camera-height 1",
        "inspect a.bin b.bin",
        "simulate",
    ],
)
def test_a_command_that_cannot_be_obeyed(unbend, words):
    ended = unbend(*words.split())
    assert ended.code == 2
    assert "Usage: unbend" in ended.text
    assert "Traceback" not in ended.text


def angle_words(changes):
    """An angle that can be had, with other values."""
    values = {"--camera-height": 3000, "--ground-height": 0, "--nadir-angle": 45} | changes
    words = ["angle"]
    for option, value in values.items():
        words.append(f"{option}={value}")
    return words


@pytest.fixture
def angle_of(unbend):
    """What `unbend angle` gives as JSON, and what it prints in one line."""

    def ask(h_c, h_g, zeta, more=""):
        values = {"--camera-height": h_c, "--ground-height": h_g, "--nadir-angle": zeta}
        words = [*angle_words(values), *more.split()]
        plain = unbend(*words)
        as_json = unbend(*words, "--json")
        assert plain.code == as_json.code == 0, plain.text
        assert longest(plain.out) <= 80
        assert "None" not in plain.out
        assert "nan" not in plain.out.lower()
        return strict_json(as_json.out), one_line(plain.out)

    return ask


ANGLES = yaml.safe_load("""
- [10000, 75, 61.778543]
- [10000, 45, 16.378452]
- [3000, 45, 7.088778]
- [120, 45, 0.327323]
- [20000, 85, 327.014637]
""")


@pytest.mark.parametrize(
    ("words", "line"),
    [
        ("mission.yaml run", "unbend run mission.yaml"),
        ("mission.yaml", "unbend run mission.yaml"),
        ("a.yml check --json", "unbend check a.yml --json"),
        ("a.yml --output run", "unbend run a.yml --output run"),
        ("{file} inspect --type BARO", "unbend inspect {file} --type BARO"),
    ],
)
def test_a_file_before_the_command(refusal_of, tmp_path, words, line):
    file = tmp_path / "flight"
    file.write_text("", "utf-8")
    text = refusal_of("COMMAND-ORDER", 2, *words.format(file=file).split())
    assert text.strip().endswith(f"write: {line.format(file=file)}")


@pytest.mark.parametrize(("h_c", "zeta", "arcsec"), ANGLES)
def test_angle(angle_of, h_c, zeta, arcsec):
    options = "--atmosphere us1976 --index gyer --radius 6371000"
    answer, text = angle_of(h_c, 0, zeta, options)
    assert answer["r_c_arcsec"] == pytest.approx(arcsec, abs=1e-6)
    assert answer["r_c_urad"] == pytest.approx(answer["r_c_arcsec"] * 4.84813681109536, rel=1e-12)
    assert answer["ground_m"] > 0.0
    assert f"{answer['r_c_arcsec']:.5g} arcsec" in text
    assert "microradians" in text
    assert answer["status"] == "ok"
    assert answer["distance_m"] is None
    assert "crossing" not in text


def test_an_angle_over_the_horizon_has_no_metres(angle_of):
    """asin(6371 / 6381) is 86.792 degrees: there the straight ray misses, the bent one lands."""
    over, text = angle_of(10_000, 0, 86.8)
    assert over["ground_m"] is None
    assert over["status"] == "ok"
    assert over["r_c_arcsec"] > 470.0
    assert "no metres on the ground: the straight ray in the apparent direction is above" in text
    before, text = angle_of(10_000, 0, 86.79)
    assert before["ground_m"] > 0.0
    assert "no metres" not in text


@pytest.mark.parametrize(
    ("distance", "status"), [(None, "beyond_grazing"), (80_000, "ok"), (340_000, "far_branch")]
)
def test_the_slant_range_chooses_the_crossing(angle_of, distance, status):
    """From 3 km the ray at 88.4 degrees has 1000 m twice, some 92 and 328 km away."""
    is_far = status == "far_branch"
    answer, text = angle_of(3000, 1000, 88.4, f"--distance {distance}" if distance else "")
    assert answer["status"] == status
    assert answer["distance_m"] == distance
    near, _ = angle_of(3000, 1000, 88.4)
    assert (answer["r_c_arcsec"] == near["r_c_arcsec"]) == (not is_far)
    zeta = math.radians(88.4)
    away_m = metres_apart(3000, 1000, zeta, zeta - answer["r_c_rad"], is_far)
    assert answer["ground_m"] == pytest.approx(away_m, rel=1e-8)
    assert ("the near one of two crossings" in text) == (distance is None)
    assert ("the far one of two crossings" in text) == is_far


def test_what_is_no_json_is_never_printed_as_json(unbend, flown, monkeypatch):
    """Whatever slips through is a bug that shows, not a file that only Python can read."""
    monkeypatch.setattr(angle, "one_angle", lambda **_: {"ground_m": math.nan})
    monkeypatch.setattr(Log, "to_json_dict", lambda _: {"duration_s": math.inf})
    for words in (angle_words({}), ["inspect", flown.logs["mcap"]]):
        with pytest.raises(ValueError, match="JSON"):
            unbend(*words, "--json")


NO_NUMBERS = yaml.safe_load("""
- ['--radius', nan, RAY-BAD-MEASUREMENT]
- ['--radius', inf, RAY-BAD-MEASUREMENT]
- ['--radius', '0', RAY-BAD-MEASUREMENT]
- ['--camera-height', inf, RAY-BAD-MEASUREMENT]
- ['--ground-height', '-inf', RAY-BAD-MEASUREMENT]
- ['--distance', '-1', ANGLE-DISTANCE]
- ['--distance', nan, ANGLE-DISTANCE]
- ['--distance', '0', ANGLE-DISTANCE]
- ['--camera-height', '1e15', RAY-OUTSIDE-PROFILE]
""")


@pytest.mark.parametrize("method", ["spherical", "plane", "gyer1996", "manual"])
@pytest.mark.parametrize(("option", "value", "code"), NO_NUMBERS)
def test_an_angle_of_what_is_no_number(unbend, method, option, value, code):
    ended = unbend(*angle_words({"--method": method, option: value}), "--json")
    assert ended.code == 2
    assert ended.out == ""
    assert ended.err.startswith(f"{code}: ")


IMPOSSIBLE_ANGLES = yaml.safe_load("""
- [{--atmosphere: us1967}, ATMOSPHERE-NAME]
- [{--method: magic}, METHOD-NAME]
- [{--index: edlen}, AIR-INDEX]
- [{--nadir-angle: 200}, RAY-BAD-MEASUREMENT]
- [{--camera-height: nan}, RAY-BAD-MEASUREMENT]
- [{--camera-height: 1e9}, RAY-OUTSIDE-PROFILE]
- [{--ground-height: -1e15}, RAY-OUTSIDE-PROFILE]
- [{--ground-height: -1e15, --method: plane}, RAY-OUTSIDE-PROFILE]
- [{--ground-height: -1e15, --method: gyer1996}, RAY-OUTSIDE-PROFILE]
- [{--nadir-angle: 120}, RAY-MISSES-GROUND]
""")


@pytest.mark.parametrize(("changes", "code"), IMPOSSIBLE_ANGLES)
def test_an_angle_that_does_not_exist(refusal_of, changes, code):
    refusal_of(code, 2, *angle_words(changes))


KEYS = {"format", "messages", "bad_bytes", "lost_messages", "boots", "channels", "duration_s"}


@pytest.mark.parametrize("kind", ["bin", "tlog", "mcap"])
def test_inspect(unbend, flown, kind):
    plain = unbend("inspect", flown.logs[kind])
    as_json = unbend("inspect", flown.logs[kind], "--json")
    assert plain.code == as_json.code == 0
    assert longest(plain.out) <= 80
    assert "rate [Hz]" in plain.out
    log = json.loads(as_json.out)
    assert set(log) >= KEYS
    assert sum(log["messages"].values()) == flown.messages[kind]
    assert log["boots"] == 1
    assert log["bad_bytes"] == log["lost_messages"] == 0
    assert log["duration_s"] == pytest.approx(flown.duration_s, abs=30.0)
    # A mission file names channels by these.
    names = {channel.name for channel in open_log(flown.logs[kind]).channels}
    assert {channel["name"] for channel in log["channels"]} == names
    assert all(name in plain.out for name in names)


@pytest.mark.skipif(os.name != "posix", reason="named pipes of POSIX")
def test_inspect_refuses_a_pipe(unbend, tmp_path):
    """It does not wait for somebody to write into it."""
    os.mkfifo(tmp_path / "flight.bin")
    ended = unbend("inspect", tmp_path / "flight.bin")
    assert ended.code == 6
    assert ended.err.startswith("LOG-MISSING: it is a pipe")


def test_inspect_of_a_cut_log_ends_with_the_code_of_losses(obeyed, flown, tmp_path):
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(flown.logs["mcap"].read_bytes()[:-5000])
    text = obeyed("inspect", cut, exit_code=3)
    assert "loss LOG-" in text


def test_check_says_what_it_understood_and_writes_nothing(obeyed, mission):
    mission.save()
    before = set(mission.folder.iterdir())
    text = one_line(obeyed("check", mission.file))
    for words in (
        "can be run",
        "3 of nadir, 3 of oblique",
        "59 in 6 images",
        "BARO[0]",
        "dataflash",
    ):
        assert words in text
    assert set(mission.folder.iterdir()) == before


def test_brackets_in_a_path_are_no_markup(unbend, mission_factory, tmp_path):
    mission = mission_factory(tmp_path / "[bold]strip[1]")
    assert "[bold]strip[1]" in re.sub(r"\n\s*", "", unbend("check", mission.save()).out)


def test_summary_of_a_run(baseline):
    ended = baseline.run()
    assert ended.code == 0
    assert ended.err == ""
    assert "All 59 observations were corrected" in ended.out
    text = one_line(ended.out)
    for words in ("cm on the ground, ", "px in the image (median; ", "[px]", "[arcsec]", "results"):
        assert words in text
    paths = [line for line in ended.out.splitlines() if str(baseline.folder) in line]
    assert len(paths) == 2  # in one piece
    for line in ended.out.splitlines():
        assert len(line) <= 80 or line in paths


def test_profile_of_a_standard(obeyed, tmp_path):
    text = obeyed("profile", "--atmosphere", "us1976")
    assert longest(text) <= 80
    assert "(n-1)e6; std is us1976 at the same height" in text
    (ground,) = [one_line(line) for line in text.splitlines() if line.startswith("    0 ")]
    assert ground == "0 288.15 288.15 1013.2 1013.2 0.00 0.00 277.84 277.84 standard"
    target = tmp_path / "air.csv"
    obeyed("profile", "--atmosphere", "us1976", "--csv", target)
    rows = pd.read_csv(target)
    ground = rows.iloc[rows["h_m"].abs().argmin()]
    assert ground["temperature_k"] == pytest.approx(288.15, abs=2.0)
    for name in ("temperature_k", "pressure_pa", "vapour_pressure_pa", "refractivity"):
        assert rows[f"standard_{name}"].equals(rows[name])


def test_profile_of_a_mission(unbend, mission, baseline, tmp_path):
    target = tmp_path / "air.csv"
    plot = tmp_path / "air.png"
    ended = unbend("profile", mission.save(), "--csv", target, "--plot", plot)
    assert ended.code == 0
    text = one_line(ended.out)
    for words in ("R at 45° from", "HYGR[0]: temperature", "note AIR-ANCHOR"):
        assert words in text
    assert ended.out.splitlines()[-2:] == [str(target), str(plot)]
    assert "source" not in ended.out.splitlines()[0]
    assert plot.read_bytes().startswith(b"\x89PNG\r\n\x1a\n")
    assert not mission.output.exists()
    pressures = pd.read_csv(target, dtype=str)["pressure_pa"].astype(float)
    profile = pd.read_parquet(baseline.output / "profile.parquet")
    assert pressures.tolist() == profile["pressure_pa"].tolist()


def test_a_profile_that_lost_something_says_so_beside_its_plot(obeyed, mission, tmp_path):
    mission.config["log"]["channels"]["temperature"] = "HYGR[7]"
    text = obeyed("profile", mission.save(), "--csv", tmp_path / "air.csv", exit_code=3)
    assert "loss CHANNEL-MISSING" in text
    assert str(tmp_path / "air.csv") in text


IMPOSSIBLE_PROFILES = yaml.safe_load("""
- ['', PROFILE-ARGUMENTS, 2]
- [a.yaml --atmosphere us1976, PROFILE-ARGUMENTS, 2]
- [a.yaml, CONFIG-MISSING, 2]
- ['--atmosphere mars', ATMOSPHERE-NAME, 2]
- ['--atmosphere us1976 --plot air.pdf', PLOT-FORMAT, 2]
- ['--atmosphere us1976 --csv none/air.csv', STORAGE-WRITE, 5]
- ['--atmosphere us1976 --plot none/air.png', STORAGE-WRITE, 5]
""")


@pytest.mark.parametrize(("words", "code", "exit_code"), IMPOSSIBLE_PROFILES)
def test_a_profile_that_cannot_be_had(refusal_of, words, code, exit_code, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    refusal_of(code, exit_code, "profile", *words.split())


def test_a_flight_that_cannot_be_simulated(refusal_of, tmp_path):
    refusal_of("SIM-OPTION", 2, "simulate", tmp_path / "flown", "--height", "-5")


def test_interrupted(unbend, monkeypatch):
    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(angle, "one_angle", interrupt)
    ended = unbend(*angle_words({}))
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
