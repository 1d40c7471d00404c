"""What a new thing costs, as CONTRIBUTING.md says: a file, and its line in a registry.

A copy of the package gets a toy of each kind, exactly those files and lines, and each is used in
another process through the command line or the names of `unbend`.
"""

import difflib
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import pytest
import yaml

import unbend
from tests.helpers import one_line
from tests.logs import REPOSITORY

PACKAGE = Path(unbend.__file__).parent
CONTRIBUTING = REPOSITORY / "CONTRIBUTING.md"

LOG_FORMAT = '''
"""A toy: a line of text a sample, with time [ns] and pressure [Pa]."""

import numpy as np

from unbend.flight.channels import Channel, Source
from unbend.ingest.flight_log import Contents


class ToyFormat:
    name, title, extensions = "toy", "Toy log", (".toy",)

    def matches(self, head):
        return head.startswith(b"toy")

    def read(self, path, ledger, witnesses=()):
        rows = np.loadtxt(path, skiprows=1, delimiter=",", ndmin=2)
        time_ns = rows[:, 0].astype(np.int64)
        channel = Channel("TOY", time_ns, {"pressure_pa": rows[:, 1]}, Source("TOY"))
        return Contents({"TOY": len(rows)}, (channel,), 0, 0, 1, "as logged")


TOY = ToyFormat()
'''

METHOD = '''
"""A toy: the plane formula, twice."""

from unbend.refraction.published.gyer import plane


def toy(profile, h_c, h_g, zeta_c, radius):
    """Twice the plane form."""
    return 2.0 * plane(profile, h_c, h_g, zeta_c, radius)
'''

ATMOSPHERE = '''def _toy(place: SeasonAndPlace, index: IndexModel) -> Profile:
    """As ARDC 1959."""
    return _tabulated_profile("ardc1959", place, index)


ATMOSPHERES: dict'''

SOUNDING = '''
"""A toy: a line a level, with height [m], pressure [Pa] and temperature [K]."""

import numpy as np

from unbend.atmosphere.soundings.levels import RawLevels


def is_toy(text):
    return text.startswith("levels of a toy")


def parse_toy(text, where):
    h_m, pressure_pa, temperature_k = np.loadtxt(text.splitlines()[1:], delimiter=",").T
    return [RawLevels(h_m, pressure_pa, temperature_k, origin="toy", where=where)]
'''

CAMERA_MODEL = '''
"""A toy: one radial coefficient."""

from typing import Any, NamedTuple


class Toy(NamedTuple):
    """The coefficient of the square of the radius."""

    k: float = 0.0


Parameters = Toy
MODELS = {"TOY": ("f", "cx", "cy", "k")}


def distort(u: Any, v: Any, parameters: Toy) -> Any:
    scale = 1.0 + parameters.k * (u * u + v * v)
    return u * scale, v * scale


def slopes(u: Any, v: Any, parameters: Toy) -> Any:
    scale, twice = 1.0 + parameters.k * (u * u + v * v), 2.0 * parameters.k
    return scale + twice * u * u, twice * u * v, scale + twice * v * v


def largest_radius(parameters: Toy) -> float:
    return 10.0
'''

# Pixels through the compiled functions, held against a plane triangle and the angle of the ray.
CAMERA_USED = """
import numpy as np
import unbend
from unbend.config.cameras import CameraSection
from unbend.refraction import Exposures
from unbend.refraction.ray import rays_by

section = CameraSection(
    width_px=1000,
    height_px=800,
    model="TOY",
    params=[900.0, 500.0, 400.0, 0.05],
    calibration="laboratory",
)
camera = section.interior_orientation
x, y = np.array([510.0, 950.0]), np.array([410.0, 60.0])
u, v, covered = camera.rays(x, y)
assert covered.all()
np.testing.assert_allclose(camera.project(u, v), (x, y), atol=1e-9)

air, one = unbend.standard_atmosphere(), np.ones(1)
down, n = np.diag([1.0, -1.0, -1.0])[None], air.refractivity(3e3) * one
at = Exposures(one > 0, down, 0.8 * one, 3e3 * one, n, n, radius_m=6.371e6)
corrected = unbend.correct_observations(
    x, y, np.zeros(2), np.zeros(2, np.int64), at, camera=camera, table=rays_by(air, "spherical")
)
zeta = np.arctan(np.hypot(u, v))
straight = np.tan(zeta - unbend.refraction_angle(air, 3e3, 0.0, zeta)) / np.tan(zeta)
expected = camera.project(u * straight, v * straight)
found = corrected.x_corrected_px, corrected.y_corrected_px
np.testing.assert_allclose(found, expected, atol=1e-8)
assert (np.hypot(corrected.dx_px, corrected.dy_px) > 1e-4).all()
"""

EXPORT = '''
"""A toy: the names of the usable images, each some times."""

from unbend.tables.exports.export_frames import ExportFrame
from unbend.tables.exports.export_format import ExportFormat, Option


def write(run, values, path, ledger):
    names = [name for name, usable in zip(run.stations.image, run.exposures.usable) if usable]
    path.write_text("\\n".join(name for name in names for _ in range(values["times"])))
    return len(names)


TIMES = Option("times", int, 1, "how often each name is written", minimum=1, maximum=9)
FORMATS = (
    ExportFormat(
        "toy", "names of the images", ".txt", write, lambda run, values: ExportFrame(), (TIMES,)
    ),
)
'''

IMPORT = '''
"""A toy: a line of text a sample, with time [ns], latitude and longitude [rad] and height [m]."""

import numpy as np

from unbend.flight.channels import Channel, Source


def read_toy(path, stated, ledger):
    rows = np.loadtxt(path, delimiter=",", ndmin=2)
    names = ("lat_rad", "lon_rad", f"h_{stated.heights}_m")
    columns = dict(zip(names, rows[:, 1:].T))
    return Channel("toy", rows[:, 0].astype(np.int64), columns, Source("toy"))
'''

BLOCK = '''
"""A toy: a line of text a camera, with its name, width, height and principal distance."""

from unbend.refraction.camera.camera import Camera


def _camera(width, height, f):
    return lambda: Camera(int(width), int(height), float(f), float(f), int(width) / 2,
                          int(height) / 2)


def block_files(path):
    return (path,)


def read_cameras(path):
    rows = [line.split() for line in path.read_text().splitlines()]
    return {name: _camera(*numbers) for name, *numbers in rows}
'''


@dataclass(frozen=True)
class Thing:
    """A toy: its new files, and the changed lines of existing ones, as (before, after)."""

    files: Mapping[str, str] = field(default_factory=dict)
    lines: Mapping[str, tuple[tuple[str, str], ...]] = field(default_factory=dict)


THINGS = {
    "log format": Thing(
        {
            "pipeline/unbend/ingest/toy/toy_log.py": LOG_FORMAT,
            "pipeline/unbend/ingest/toy/__init__.py": '"""Toy."""',
        },
        {
            "pipeline/unbend/ingest/registry.py": (
                ("import TLOG\n", "import TLOG\nfrom unbend.ingest.toy.toy_log import TOY\n"),
                ("= (MCAP,", "= (TOY, MCAP,"),
            )
        },
    ),
    "atmosphere": Thing(
        {},
        {
            "pipeline/unbend/atmosphere/standard.py": (
                ("ATMOSPHERES: dict", ATMOSPHERE),
                (
                    "    AUTO: _OF_SEASON,\n",
                    '    AUTO: _OF_SEASON,\n    "toy": AtmosphereModel(_toy, "a toy", False),\n',
                ),
            )
        },
    ),
    "refraction method": Thing(
        {"pipeline/unbend/refraction/published/toy.py": METHOD},
        {
            "pipeline/unbend/refraction/published/__init__.py": (
                ("\nPUBLISHED", "from unbend.refraction.published.toy import toy\n\nPUBLISHED"),
                ('    "manual": manual,\n', '    "manual": manual,\n    "toy": toy,\n'),
            )
        },
    ),
    "sounding format": Thing(
        {"pipeline/unbend/atmosphere/soundings/toy.py": SOUNDING},
        {
            "pipeline/unbend/atmosphere/soundings/formats.py": (
                (
                    "from unbend.atmosphere.soundings.wyoming import (",
                    "from unbend.atmosphere.soundings.toy import is_toy, parse_toy\n"
                    "from unbend.atmosphere.soundings.wyoming import (",
                ),
                (
                    '    "csv": (is_plain, parse_plain),\n',
                    '    "csv": (is_plain, parse_plain),\n    "toy": (is_toy, parse_toy),\n',
                ),
            )
        },
    ),
    "camera model": Thing(
        {"pipeline/unbend/refraction/camera/toy.py": CAMERA_MODEL},
        {
            "pipeline/unbend/refraction/camera/__init__.py": (
                ("import brown_conrady, general", "import brown_conrady, toy, general"),
                (
                    '    "brown_conrady": brown_conrady,\n',
                    '    "brown_conrady": brown_conrady,\n    "toy": toy,\n',
                ),
            )
        },
    ),
    "block": Thing(
        {"pipeline/unbend/tables/imports/blocks/toy.py": BLOCK},
        {
            "pipeline/unbend/tables/imports/blocks/__init__.py": (
                (
                    '    "opensfm": (',
                    '    "toy": ("unbend.tables.imports.blocks.toy", (".toycam",)),\n'
                    '    "opensfm": (',
                ),
            )
        },
    ),
    "import": Thing(
        {"pipeline/unbend/tables/imports/toy.py": IMPORT},
        {
            "pipeline/unbend/tables/imports/__init__.py": (
                (
                    '    "sbet": (',
                    '    "toy": ("unbend.tables.imports.toy:read_toy", (".toy",)),\n    "sbet": (',
                ),
            )
        },
    ),
    "export": Thing(
        {"pipeline/unbend/tables/exports/toy.py": EXPORT},
        {
            "pipeline/unbend/tables/exports/__init__.py": (
                ("    station_files,\n)", "    station_files,\n    toy,\n)"),
                ("opensfm_project,\n    bingo,", "opensfm_project,\n    bingo,\n    toy,"),
            )
        },
    ),
}


# A line is code to run, or the words of a command; the answer is how it ended and what it said.
SERVER = """
import contextlib, io, json, sys, traceback
for line in sys.stdin:
    asked, said, code = json.loads(line), io.StringIO(), 0
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        try:
            if isinstance(asked, str):
                exec(asked, {})
            else:
                from unbend.cli import main
                sys.argv = ["unbend", *asked]
                main()
        except SystemExit as end:
            code = int(end.code or 0)
        except BaseException:
            traceback.print_exc()
            code = -1
    print(json.dumps([code, said.getvalue()]), flush=True)
"""


@dataclass(frozen=True)
class Copy:
    """A copy of the package with the toys in it, and a process that has imported it."""

    folder: Path
    process: subprocess.Popen[str]

    def answer(self, asked, code):
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        print(json.dumps(asked), file=self.process.stdin, flush=True)
        ended, said = json.loads(self.process.stdout.readline())
        assert ended == code, said
        return str(said)

    def python(self, code):
        return self.answer(code, 0)

    def unbend(self, *words, code=0):
        return self.answer([str(word) for word in words], code)


@pytest.fixture(scope="module")
def copy(tmp_path_factory):
    """All toys in one copy and one process, so that it is imported and compiled once."""
    folder = tmp_path_factory.mktemp("toys")
    shutil.copytree(
        PACKAGE, folder / "pipeline" / "unbend", ignore=shutil.ignore_patterns("__pycache__")
    )
    for thing in THINGS.values():
        for name, content in thing.files.items():
            (folder / name).parent.mkdir(exist_ok=True)
            (folder / name).write_text(content.lstrip(), "utf-8")
        for name, changes in thing.lines.items():
            text = (folder / name).read_text("utf-8")
            for before, after in changes:
                assert text.count(before) == 1, f"{before!r} does not stand once in {name}"
                text = text.replace(before, after)
            (folder / name).write_text(text, "utf-8")
    environment = {
        "PYTHONPATH": str(folder / "pipeline"),
        "NUMBA_CACHE_DIR": str(folder / "compiled"),
    }
    with subprocess.Popen(
        [sys.executable, "-c", SERVER],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        encoding="utf-8",
        cwd=folder,
        env=os.environ | environment | {"PYTHONIOENCODING": "utf-8"},
    ) as process:
        made = Copy(folder, process)
        assert str(folder) in made.python("import unbend; print(unbend.__file__)")
        yield made
        assert process.stdin is not None
        process.stdin.close()


def documented():
    """The table of CONTRIBUTING.md: new file, registry and line by kind of thing."""
    text = CONTRIBUTING.read_text("utf-8")
    table = text.split("| new thing | new file | registry | line |\n")[1].split("\n\n")[0]
    rows = [[cell.strip() for cell in row.strip("|").split("|")] for row in table.splitlines()[1:]]
    return {kind: (file, registry, line) for kind, file, registry, line in rows}


def test_every_documented_thing_is_tried():
    assert set(documented()) == set(THINGS)


@pytest.mark.parametrize("kind", THINGS)
def test_a_toy_is_what_the_table_says(kind):
    """One new file (a sub-package's __init__ beside it), one registry, at most two lines of it."""
    file, registry, line = documented()[kind]
    thing = THINGS[kind]
    pattern = re.compile(re.sub(r"<\w+>", "toy", re.findall(r"`([^`]+)`", file)[0]))
    new = [name for name in thing.files if not name.endswith("__init__.py")]
    assert [bool(pattern.fullmatch(name)) for name in new] == ([] if "none" in file else [True])
    assert [f"`{name}`" for name in thing.lines] == [registry]
    name = re.findall(r"`([^`]+)`", line)[0]
    text = (PACKAGE.parents[1] / registry.strip("`")).read_text("utf-8")
    assert re.search(rf"^{name}\b", text, re.MULTILINE)
    changes = [change for changes in thing.lines.values() for change in changes]
    added = []
    for before, after in changes:
        diff = "\n".join(difflib.ndiff(before.splitlines(), after.splitlines()))
        added += re.findall(r"^\+ .*\S.*$", diff, re.MULTILINE)
    allowed = 2 if "none" not in file else 8  # a line and its import; or a function and its line
    assert len(added) <= allowed, added


def test_a_log_format(copy):
    (copy.folder / "flight.toy").write_text("toy\n1000000000,101325\n2000000000,101300\n")
    shown = copy.unbend("inspect", "flight.toy")
    assert "TOY" in shown
    code = "import unbend; print(unbend.open_log('flight.toy').channel('TOY')['pressure_pa'])"
    assert "101325" in copy.python(code)


def test_an_atmosphere(copy):
    words = ("--camera-height", 3000, "--ground-height", 0, "--nadir-angle", 45, "--json")
    toy, ardc, us = (
        json.loads(copy.unbend("angle", "--atmosphere", name, *words))["r_c_arcsec"]
        for name in ("toy", "ardc1959", "us1976")
    )
    assert toy == ardc != us
    copy.unbend("profile", "--atmosphere", "toy")
    assert "toy" in copy.unbend("angle", "--atmosphere", "none of them", *words, code=2)
    mission = yaml.safe_load((CONTRIBUTING.parent / "configs" / "sample_bin.yaml").read_text())
    mission["atmosphere"] = {"standard": "toy", "climatology": "toy"}
    (copy.folder / "mission.yaml").write_text(yaml.safe_dump(mission))
    code = "import unbend; print(unbend.load_mission('mission.yaml').atmosphere.climatology)"
    assert "toy" in copy.python(code)


def test_a_refraction_method(copy):
    words = ("--camera-height", 3000, "--ground-height", 0, "--nadir-angle", 45, "--json")
    code = (
        "import unbend; air = unbend.standard_atmosphere()\n"
        "toy, plane = (unbend.refraction_angle(air, 3e3, 0.0, 0.7, method=m) "
        "for m in ('toy', 'plane'))\nassert toy == 2 * plane > 0"
    )
    copy.python(code)
    assert "toy" in copy.unbend("angle", *words, "--method", "toy")
    assert "toy" in copy.unbend("angle", *words, "--method", "none of them", code=2)
    assert "toy" in copy.unbend("angle", "--help")
    copy.unbend("tables", "accuracy", "--out", "page.md")
    assert "`toy` minus `spherical`" in (copy.folder / "page.md").read_text("utf-8")


def test_a_sounding_format(copy):
    rows = ["levels of a toy"]
    for h_m in range(0, 5000, 500):
        pressure_pa = 101_325.0 * (1.0 - 2.25577e-5 * h_m) ** 5.25588
        rows.append(f"{h_m},{pressure_pa},{288.15 - 0.0065 * h_m}")
    (copy.folder / "ascent.txt").write_text("\n".join(rows) + "\n")
    shown = json.loads(copy.unbend("inspect", "ascent.txt", "--json"))
    assert (shown["kind"], shown["format"]) == ("sounding", "toy")
    code = (
        "from unbend.config.atmosphere import SoundingSection\n"
        "print(SoundingSection(path='ascent.txt', format='toy').format)"
    )
    assert "toy" in copy.python(code)


def test_a_camera_model(copy):
    copy.python(CAMERA_USED)


def test_a_camera_file(copy):
    (copy.folder / "cameras.toycam").write_text("left 400 300 500\nright 400 300 501\n")
    code = (
        "from pathlib import Path\n"
        "from unbend.config.cameras import CameraSection\n"
        "camera = CameraSection(file='cameras.toycam', camera='right', calibration='laboratory')\n"
        "print(camera.with_file(Path('cameras.toycam')).interior_orientation.fx_px)"
    )
    assert "501" in copy.python(code)


def test_an_export(copy, baseline):
    shown = one_line(copy.unbend("export", "--help"))
    assert "names of the images" in shown
    assert "--times" in shown
    assert "how often each name is written" in shown
    run = ("export", baseline.output, "--format", "toy", "--times", 2)
    copy.unbend(*run, "--out", copy.folder / "names.txt")
    names = (copy.folder / "names.txt").read_text().splitlines()
    assert len(names) == 2 * len(set(names)) > 0
    assert "EXPORT-OPTION" in copy.unbend(*run, "--columns", 3, "--out", "n.txt", code=2)


def test_an_import(copy):
    (copy.folder / "flown.toy").write_text("1000000000,0.8,0.2,500\n2000000000,0.8,0.2,501\n")
    mission = yaml.safe_load((CONTRIBUTING.parent / "configs" / "sample_bin.yaml").read_text())
    trajectory = {"path": "flown.toy", "format": "toy", "point": "imu", "heights": "msl"}
    mission["stations"] = {"trajectory": trajectory}
    (copy.folder / "with_toy.yaml").write_text(yaml.safe_dump(mission))
    code = (
        "import unbend; from pathlib import Path; from unbend.messages import Ledger\n"
        "from unbend.tables.imports import TRAJECTORIES, reader_of\n"
        "from unbend.tables.imports.stated import Stated\n"
        "stated = unbend.load_mission('with_toy.yaml').stations.trajectory\n"
        "by_ending = reader_of(TRAJECTORIES, Path('flown.toy'), None)\n"
        "read = reader_of(TRAJECTORIES, Path('flown.toy'), stated.format)\n"
        "assert read is by_ending\n"
        "print(read(Path('flown.toy'), Stated(heights=stated.heights), Ledger())['h_msl_m'])"
    )
    assert "501" in copy.python(code)
    mission["stations"]["trajectory"]["format"] = "none of them"
    (copy.folder / "with_toy.yaml").write_text(yaml.safe_dump(mission))
    assert "toy" in copy.unbend("check", "with_toy.yaml", code=2)
