"""What README.md shows works as it stands there."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from pipeline.config import load_mission

README = Path(__file__).resolve().parents[2] / "README.md"


def blocks(kind: str) -> list[str]:
    if not README.is_file():
        pytest.skip("there is no README.md")
    return re.findall(rf"```{kind}\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)


def commands() -> list[list[str]]:
    text = README.read_text(encoding="utf-8") if README.is_file() else ""
    shown = re.findall(r"^    unbend ([^#\n]+)", text, re.MULTILINE)
    return [line.split() for line in shown + re.findall(r"`unbend ([^`]+)`", text)]


def test_the_mission_file_loads(tmp_path):
    shown = blocks("yaml")
    whole = [block for block in shown if block.startswith("mission:")]
    sections = [block for block in shown if not block.startswith("mission:")]
    # The second is run in tests/stages/test_oriented_stations.py, the third in test_blocks.py.
    assert len(whole) == 3
    assert len(sections) == 2
    for block in [*whole, *(whole[0] + section for section in sections)]:
        (tmp_path / "mission.yaml").write_text(block, encoding="utf-8")
        assert load_mission(tmp_path / "mission.yaml").output.path.startswith("results/")


def test_the_table_of_observations_is_one(tmp_path):
    from pipeline.ledger import Ledger
    from pipeline.tables.observations import open_observations

    (block,) = blocks("csv")
    (tmp_path / "o.csv").write_text(block, encoding="utf-8")
    columns = {name: name for name in ("image", "point", "x_px", "y_px")}
    table = open_observations(tmp_path / "o.csv", columns, "h_g_m", Ledger())
    assert table.rows == len(block.splitlines()) - 1


def test_every_command_and_option_exists(unbend):
    shown = commands()
    if not shown:
        pytest.skip("README.md shows no commands")
    for words in shown:
        if words[0].startswith("-"):
            assert unbend(words[0]).code == 0
            continue
        assert words[0].isalpha(), words
        help_text = unbend(words[0], "--help")
        if help_text.code != 0:  # a sentence such as "unbend refuses its own output"
            raise AssertionError(f"README.md shows `unbend {' '.join(words)}`")
        for option in (word for word in words[1:] if word.startswith("--")):
            assert option in help_text.out, words


def test_the_angle_is_what_it_says(unbend):
    text = README.read_text(encoding="utf-8") if README.is_file() else ""
    found = re.search(r"    unbend (angle .*)\n\s*\ngives ([0-9.]+) arcsec", text)
    if found is None:
        pytest.skip("README.md shows no angle")
    assert f"{found[2]} arcsec" in unbend(*found[1].split()).out


@pytest.mark.parametrize("number", range(4))
def test_the_examples_in_python_run(baseline, tmp_path, number):
    found = blocks("python")
    if number >= len(found):
        pytest.skip(f"README.md has {len(found)} examples")
    for name in ("duckdb", "pycolmap"):
        if f"import {name}" in found[number]:
            pytest.importorskip(name)
    shutil.copytree(baseline.output, tmp_path / "results" / "sample_bin")
    (tmp_path / "sample_logs").mkdir()
    shutil.copy(baseline.folder / "observations.parquet", tmp_path / "sample_logs")
    # A nadir block with its angles: level and to the north, which is enough to compute.
    placed = baseline.stations().to_pandas().query("camera == 'nadir'")
    placed[["image", "lat_deg", "lon_deg", "h_ellipsoid_m"]].rename(
        columns={"lat_deg": "latitude", "lon_deg": "longitude"}
    ).assign(omega=0.0, phi=0.0, kappa=0.0).to_csv(tmp_path / "opk.csv", index=False)
    seen = baseline.measurements().to_pandas()
    seen[seen["image"].isin(placed["image"])].to_csv(tmp_path / "observations.csv", index=False)
    done = subprocess.run(
        [sys.executable, "-c", found[number]], capture_output=True, text=True, cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
