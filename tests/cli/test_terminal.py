"""What commands write where: to a terminal, a pipe, as JSON, or nothing."""

import contextlib
import json
import os
import pty
import re
import subprocess
import sys

import pytest
import yaml

NASTY = "nadir\x1b[31m\r\n\u202e"


UNBEND = ("-m", "unbend")
# The bar at once, however short the work is.
IMPATIENT = (
    "-c",
    "from unbend.report import progress; progress.DELAY_S = 0.0\n"
    "from unbend.cli import main; main()",
)


def in_terminal(*words, python=UNBEND, **environment):
    """What `unbend` writes to a terminal of its own."""
    master, slave = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, *python, *words],
        stdin=slave,
        stdout=slave,
        stderr=slave,
        env=dict(os.environ, TERM="xterm", COLUMNS="80") | environment,
    )
    os.close(slave)
    parts = []
    with contextlib.suppress(OSError):  # Linux, once the process has ended
        while part := os.read(master, 65536):
            parts.append(part)
    os.close(master)
    process.wait()
    return b"".join(parts).decode()


def test_a_pipe_gets_whole_lines_without_colours(unbend, baseline, flown, monkeypatch, obeyed):
    monkeypatch.delenv("COLUMNS", raising=False)
    for words in (
        ("run", baseline.file),
        ("check", baseline.file),
        ("stations", baseline.file),
        ("inspect", flown.logs["bin"]),
        ("profile", baseline.file),
        ("tables", "bertram1966"),
    ):
        text = obeyed(*words)
        assert "\x1b" not in text
        assert not [line for line in text.splitlines() if line != line.rstrip()]
    lines = unbend("check", baseline.file).out.splitlines()
    assert not any(line.startswith("  note ") for line in lines)
    assert re.fullmatch(r"  \d+ notes: all of them with -v", lines[-1])
    lines = unbend("check", baseline.file, "-v").out.splitlines()
    assert any(line.startswith("  note STATIONS-SIGMA") and "deg" in line for line in lines)


ANSWERS = yaml.safe_load("""
run {mission}: [config, exit_code, manifest, output, repeated]
check {mission}: [config, exit_code, lines, manifest]
stations {mission}: [exit_code, ledger, stations, written]
inspect {log}: [channels, duration_s, flight, roles]
profile --atmosphere us1976: [effect, exit_code, ledger, profile]
angle --camera-height 3000 --ground-height 0: [ledger, rows]
angle --camera-height 3000 --ground-height 0 --nadir-angle 45: [r_c_arcsec]
tables bertram1966: [notes, rows]
verify {run}: [files, mission, whole]
export {run} --format lattice-csv --force --out l.csv: [ledger, out, rows]
init {log} --force --out m.yaml: [questions, written]
init {log} --out -: [questions, text]
schema --out s.json: [written]
schema: [properties, required]
help f_px: [lines, word]
""")
"""Commands, and keys of their JSON."""


@pytest.mark.parametrize("command", ANSWERS)
def test_json_is_all_that_is_written_and_quiet_writes_nothing(
    unbend, baseline, flown, tmp_path, monkeypatch, command
):
    monkeypatch.chdir(tmp_path)
    files = {"mission": baseline.file, "run": baseline.output, "log": flown.logs["bin"]}
    words = command.format(**files).split()
    ended = unbend(*words, "--json", "--quiet")
    content = json.loads(ended.out)
    if isinstance(content, list):
        content = content[0]
    assert content.keys() >= set(ANSWERS[command])
    assert ended.err == ""
    quiet = unbend(*words, "--quiet")
    assert quiet.out == quiet.err == ""
    assert quiet.code == ended.code


def test_the_json_of_a_run_has_its_manifest(unbend, baseline):
    (run,) = json.loads(unbend("run", baseline.file, "--json").out)
    # Read now: the first run of a mission just written adds the times of its inputs.
    assert run["manifest"] == baseline.manifest()


def test_a_refused_mission_is_in_the_json_and_on_standard_error(unbend, tmp_path):
    ended = unbend("run", tmp_path / "none.yaml", "--json")
    (only,) = json.loads(ended.out)
    assert only["exit_code"] == ended.code == 2
    assert only["refusal"]["code"] in ended.err
    assert unbend("run", tmp_path / "none.yaml", "--quiet").err == ended.err


def test_names_never_steer_the_terminal(unbend, mission):
    table = mission.measured_rows()
    table["image"] = NASTY + table["image"]
    mission.observe_rows(table)
    config = mission.save()
    for command, file in (
        ("stations", config),
        ("check", config),
        ("run", config),
        ("run", "nadir\x1b[31m\u202e.yaml"),
    ):
        ended = unbend(command, file)
        assert ended.code in (2, 3, 6), ended.text
        for mark in ("\x1b", "\r", "\u202e"):
            assert mark not in ended.text
        written = r"nadir\x1b[31m\r\n\u202e" if file == config else r"nadir\x1b[31m\u202e.yaml"
        assert written in ended.text, command


def test_h_is_help_and_bash_completes(unbend, monkeypatch):
    for words in ([], ["run"], ["inspect"], ["export"]):
        assert unbend(*words, "-h").out == unbend(*words, "--help").out
    assert "--show-completion" in unbend("--help").out  # which shell it is asks a terminal
    for typed, expected in (
        ("unbend ins", "inspect"),
        ("unbend export x --format colm", "colmap"),
        ("unbend angle --method gy", "gyer1996"),
    ):
        monkeypatch.setenv("_UNBEND_COMPLETE", "complete_bash")
        monkeypatch.setenv("COMP_WORDS", typed)
        monkeypatch.setenv("COMP_CWORD", str(len(typed.split()) - 1))
        assert expected in unbend().out.split()


@pytest.mark.skipif(os.name == "nt", reason="no pseudo-terminals")
def test_a_terminal_is_not_left_silent(flown, tmp_path):
    """A first run, with everything to compile: the bar says so; none of it stays."""
    cache = str(tmp_path / "cache")
    words = ("angle", "--camera-height", "3000", "--ground-height", "0", "--nadir-angle", "45")
    text = in_terminal(*words, NUMBA_CACHE_DIR=cache)
    assert "(compiling, once)" in text
    assert "R_c    7.10" in text.split("\x1b[2K")[-1]
    dumb = in_terminal(*words, python=IMPATIENT, NUMBA_CACHE_DIR=cache, TERM="dumb")
    assert "\x1b" not in dumb
    assert "tracing the ray ..." in dumb
