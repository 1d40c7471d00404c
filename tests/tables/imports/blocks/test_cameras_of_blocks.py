"""Cameras of other programs, against those programs' own formulas, libraries and blocks."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import numpy as np
import pytest

from unbend.errors import InputError
from unbend.tables.imports.blocks import read_camera
from unbend.tables.pixels import PixelSystem

BLOCKS = Path(__file__).resolve().parents[5] / "shared" / "ba"
RAYS = np.stack(np.meshgrid(np.linspace(-0.5, 0.5, 9), np.linspace(-0.4, 0.4, 7))).reshape(2, -1)


def projected(camera):
    return np.stack(camera.project(*RAYS), axis=1)


# COLMAP


@pytest.mark.parametrize("name", ["cameras.txt", "cameras.bin"])
def test_what_pycolmap_writes(tmp_path, name):
    pycolmap = pytest.importorskip("pycolmap")
    block = pycolmap.Reconstruction()
    given = {
        1: ("SIMPLE_RADIAL", [3200.0, 2001.5, 1502.25, -0.05]),
        2: ("FULL_OPENCV", [3200.0, 3210.0, 1990.0, 1510.0, 0.08, -0.02, 2e-4, -3e-4, 1e-3, 0.1,
                            -0.01, 1e-3]),
        7: ("OPENCV_FISHEYE", [1500.0, 1510.0, 1990.0, 1510.0, -0.02, 0.004, -1e-3, 1e-4]),
        9: ("FOV", [1500.0, 1510.0, 1990.0, 1510.0, 0.9]),
        11: ("PINHOLE", [3200.0, 3201.0, 2001.5, 1502.25]),
    }  # fmt: skip
    for number, (model, params) in given.items():
        block.add_camera(
            pycolmap.Camera(model=model, width=4000, height=3000, params=params, camera_id=number)
        )
    (block.write_text if name.endswith("txt") else block.write_binary)(str(tmp_path))
    rays = np.stack([*RAYS, np.ones(RAYS.shape[1])], axis=1)
    for number in (1, 2, 7, 11):
        camera = read_camera(tmp_path / name, None, str(number))
        wanted = block.cameras[number].img_from_cam(rays)
        np.testing.assert_allclose(projected(camera), wanted, rtol=0.0, atol=1e-9)
        assert (camera.width_px, camera.height_px) == (4000, 3000)
    with pytest.raises(InputError) as refused:
        read_camera(tmp_path / name, None, "9")
    assert refused.value.code == "CAMERA-MODEL"
    with pytest.raises(InputError, match="'1', '2', '7', '9', '11'") as refused:
        read_camera(tmp_path / name, None, None)
    assert refused.value.code == "CAMERA-NAME"


# OpenSfM

BROWN = {
    "projection_type": "brown",
    "width": 4000,
    "height": 3000,
    "focal_x": 0.85,
    "focal_y": 0.852,
    "c_x": 0.003,
    "c_y": -0.002,
    "k1": -0.03,
    "k2": 0.01,
    "k3": -0.002,
    "p1": 4e-4,
    "p2": -7e-4,
}


def opensfm_pixels(given):
    """OpenSfM's documented projection: normalised by the longer side, pixels from the centre of
    the upper left one: x = size * (x_normalised) - 0.5 + w / 2."""
    u, v = RAYS
    r2 = u * u + v * v
    g = dict.fromkeys(("k1", "k2", "k3", "k4", "p1", "p2", "c_x", "c_y"), 0.0) | given
    if "fisheye" in given["projection_type"]:
        theta = np.arctan(np.sqrt(r2))
        bent = (
            theta
            * (
                1
                + g["k1"] * theta**2
                + g["k2"] * theta**4
                + g["k3"] * theta**6
                + g["k4"] * theta**8
            )
            / np.sqrt(r2 + 1e-300)
        )
        x = u * bent
        y = v * bent
    else:
        radial = 1 + g["k1"] * r2 + g["k2"] * r2**2 + g["k3"] * r2**3
        x = u * radial + 2 * g["p1"] * u * v + g["p2"] * (r2 + 2 * u * u)
        y = v * radial + 2 * g["p2"] * u * v + g["p1"] * (r2 + 2 * v * v)
    f_x = g.get("focal", g.get("focal_x"))
    f_y = g.get("focal", g.get("focal_y"))
    size = max(g["width"], g["height"])
    return np.stack(
        [
            size * (f_x * x + g["c_x"]) - 0.5 + g["width"] / 2,
            size * (f_y * y + g["c_y"]) - 0.5 + g["height"] / 2,
        ],
        axis=1,
    )


@pytest.mark.parametrize(
    "given",
    [
        BROWN,
        BROWN | {"width": 3000, "height": 4000},
        {
            "projection_type": "perspective",
            "width": 3264,
            "height": 2448,
            "focal": 0.87,
            "k1": 0.0885,
            "k2": -0.2324,
        },
        {
            "projection_type": "fisheye",
            "width": 4000,
            "height": 3000,
            "focal": 0.5,
            "k1": -0.02,
            "k2": 0.003,
        },
        {
            "projection_type": "fisheye_opencv",
            "width": 4000,
            "height": 3000,
            "focal_x": 0.5,
            "focal_y": 0.501,
            "c_x": 0.01,
            "c_y": 0.002,
            "k1": -0.02,
            "k2": 0.003,
            "k3": 1e-3,
            "k4": -1e-4,
        },
    ],
)
def test_opensfm(tmp_path, given):
    path = tmp_path / "camera_models.json"
    path.write_text(json.dumps({"v2 dji fc 1": given}))
    camera = read_camera(path, None, None)
    np.testing.assert_allclose(
        projected(camera), PixelSystem("centre").to_colmap(opensfm_pixels(given)), rtol=0, atol=1e-9
    )


OPENSFM = [Path(__file__).resolve().parents[3] / "data" / "opensfm"]
OPENSFM += [folder for folder in [BLOCKS / "opensfm_berlin"] if folder.is_dir()]


@pytest.mark.parametrize("folder", OPENSFM, ids=lambda folder: folder.name)
def test_a_block_of_opensfm(folder):
    """Its points through its poses and our camera land on its tracks."""
    (path,) = folder.glob("reconstruction*.json")
    (tracks_path,) = folder.glob("tracks*.csv")
    from scipy.spatial.transform import Rotation

    (block,) = json.loads(path.read_text())
    ((name, stated),) = block["cameras"].items()
    size = np.array([stated["width"], stated["height"]])
    camera = read_camera(path, None, name)
    tracks = tracks_path.read_text().splitlines()[1:]
    off = []
    for line in tracks:
        image, track, _, x, y = line.split("\t")[:5]
        if image in block["shots"] and track in block["points"]:
            shot = block["shots"][image]
            point = (
                Rotation.from_rotvec(shot["rotation"]).apply(block["points"][track]["coordinates"])
                + shot["translation"]
            )
            found = camera.project(*(np.array([c]) for c in point[:2] / point[2]))
            # Counted from the centre of the upper left pixel, then to COLMAP's rule.
            measured = np.array([float(x), float(y)]) * size.max() + (size - 1) / 2
            off.append(np.ravel(found) - (measured + 0.5))
    off = np.array(off)
    assert len(off) > 80
    assert np.median(np.hypot(*off.T)) < 1.5


# Metashape

FRAME = {
    "f": 3666.5,
    "cx": 12.75,
    "cy": -20.5,
    "b1": 1.25,
    "b2": -0.75,
    "k1": -0.05,
    "k2": 0.02,
    "k3": -0.004,
    "k4": 0.0006,
    "p1": 4e-4,
    "p2": -9e-4,
}


def calibration(numbers, kind="frame"):
    tags = "".join(f"<{name}>{value!r}</{name}>" for name, value in numbers.items())
    return (
        f"<calibration><projection>{kind}</projection><width>5472</width>"
        f"<height>3648</height>{tags}</calibration>"
    )


def metashape_pixels(given, kind):
    """The formulas of the user manual's appendix on camera models."""
    g = dict.fromkeys(FRAME, 0.0) | given
    x, y = RAYS
    if kind == "fisheye":
        r0 = np.hypot(x, y) + 1e-300
        x = x * np.arctan(r0) / r0
        y = y * np.arctan(r0) / r0
    r = np.hypot(x, y)
    radial = 1 + g["k1"] * r**2 + g["k2"] * r**4 + g["k3"] * r**6 + g["k4"] * r**8
    x_ = x * radial + (g["p1"] * (r**2 + 2 * x**2) + 2 * g["p2"] * x * y)
    y_ = y * radial + (g["p2"] * (r**2 + 2 * y**2) + 2 * g["p1"] * x * y)
    return np.stack(
        [
            5472 * 0.5 + g["cx"] + x_ * g["f"] + x_ * g["b1"] + y_ * g["b2"],
            3648 * 0.5 + g["cy"] + y_ * g["f"],
        ],
        axis=1,
    )


@pytest.mark.parametrize(
    ("left_out", "kind"),
    [
        ((), "frame"),
        (("k4",), "frame"),
        (("b2",), "frame"),
        (("k4", "b2"), "frame"),
        (("p1", "p2", "b2"), "fisheye"),
    ],
)
def test_metashape(tmp_path, left_out, kind):
    given = {name: value for name, value in FRAME.items() if name not in left_out}
    path = tmp_path / "calibration.xml"
    path.write_text(calibration(given, kind))
    camera = read_camera(path, None, None)
    np.testing.assert_allclose(
        projected(camera), metashape_pixels(given, kind), rtol=0.0, atol=1e-9
    )
    u, v, covered = camera.rays(*projected(camera).T)
    assert covered.sum() > 40
    np.testing.assert_allclose((u[covered], v[covered]), RAYS[:, covered], rtol=0.0, atol=1e-12)


def ply(path, fields):
    content = path.read_bytes()
    return np.frombuffer(content[content.index(b"end_header\n") + 11 :], np.dtype(fields))


@pytest.mark.shared("ba")
def test_a_block_of_metashape(tmp_path):
    """Points of the archive through its poses and the camera read from it land on its own
    projections; half a pixel more or less in the principal point would show in their mean."""
    path = BLOCKS / "dbat_sxb" / "sxb.psz"
    from xml.etree import ElementTree

    camera = read_camera(path, None, "unknown")
    # DBAT's own reading of the same camera: 123.9392 mm, pixels of 6 um.
    assert camera.fx_px == pytest.approx(123.9392 / 0.006, abs=0.05)
    with zipfile.ZipFile(path) as archive:
        archive.extractall(tmp_path)
    points = ply(
        tmp_path / "points0.ply", [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("id", "<u4")]
    )
    xyz = np.stack([points["x"], points["y"], points["z"], np.ones(points.size)])
    row_of = {int(number): row for row, number in enumerate(points["id"])}
    off = []
    chunk = ElementTree.parse(tmp_path / "doc.xml").getroot().find(".//chunk")
    for element in chunk.find("cameras").iter("camera"):
        pose = np.array(element.findtext("transform").split(), float).reshape(4, 4)
        seen = ply(
            tmp_path / f"projections{element.get('id')}.ply",
            [("x", "<f4"), ("y", "<f4"), ("size", "<f4"), ("id", "<i4")],
        )
        known = np.array([int(number) in row_of for number in seen["id"]])
        rows = [row_of[int(number)] for number in seen["id"][known]]
        ray = (np.linalg.inv(pose) @ xyz[:, rows])[:3]
        x, y = camera.project(ray[0] / ray[2], ray[1] / ray[2])
        off.append(np.stack([x - seen["x"][known], y - seen["y"][known]], axis=1))
    off = np.concatenate(off)
    assert len(off) > 1000
    assert np.median(np.hypot(*off.T)) < 1.5
    assert np.abs(np.median(off, axis=0)).max() < 0.1


def document(*calibrations):
    sensors = "".join(
        f'<sensor id="{i}" label="FC6310">{text}</sensor>' for i, text in enumerate(calibrations)
    )
    return f'<document version="2.0"><chunk><sensors>{sensors}</sensors></chunk></document>'


def of_class(name, f):
    return (
        f'<calibration type="frame" class="{name}"><resolution width="100" height="80"/>'
        f"<f>{f}</f></calibration>"
    )


def test_the_adjusted_calibration_counts(tmp_path):
    path = tmp_path / "cameras.xml"
    path.write_text(document(of_class("initial", 90.0) + of_class("adjusted", 95.0)))
    assert read_camera(path, None, None).fx_px == 95.0
    path.write_text(document(of_class("initial", 90.0)))
    with pytest.raises(InputError, match="no adjusted calibration"):
        read_camera(path, None, None)
    path.write_text(document('<property name="fixed" value="true"/>' + of_class("initial", 90.0)))
    assert read_camera(path, None, None).fx_px == 90.0
    path.write_text(document(of_class("adjusted", 95.0), of_class("adjusted", 96.0)))
    assert read_camera(path, None, "FC6310 1").fx_px == 96.0


# What is no file of a program


@pytest.mark.parametrize(
    ("name", "content", "code"),
    [
        ("cameras.txt", "1 PINHOLE 4000\n", "IMPORT-FORMAT"),
        ("cameras.txt", "1 PINHOLE 4000 3000 1.0\n", "CAMERA-MODEL"),
        ("cameras.txt", "# nothing\n", "CAMERA-NAME"),
        ("cameras.bin", "text", "IMPORT-FORMAT"),
        ("models.json", "{", "IMPORT-FORMAT"),
        ("models.json", '{"a": {"width": 5}}', "IMPORT-FORMAT"),
        ("models.json", '[{"cameras": {}}, {"cameras": {}}]', "IMPORT-FORMAT"),
        (
            "models.json",
            '{"a": {"projection_type": "spherical", "width": 9, "height": 4, "focal": 1}}',
            "CAMERA-MODEL",
        ),
        ("calibration.xml", "<calibration>", "IMPORT-FORMAT"),
        ("calibration.xml", calibration(FRAME | {"p3": 0.1}), "IMPORT-FORMAT"),
        ("calibration.xml", calibration(FRAME, "fisheye"), "IMPORT-FORMAT"),
        ("calibration.xml", calibration(FRAME, "spherical"), "CAMERA-MODEL"),
        ("block.psz", "no archive", "IMPORT-FORMAT"),
        ("camera.cal", "", "IMPORT-FORMAT"),
    ],
)
def test_what_cannot_be_read_is_refused(tmp_path, name, content, code):
    path = tmp_path / name
    path.write_text(content)
    with pytest.raises(InputError) as refused:
        read_camera(path, None, None)
    assert refused.value.code == code
    file, _, camera = refused.value.where.partition(", camera ")
    assert file == str(path)
    if code == "CAMERA-MODEL":
        assert camera in {"1, line 1", "a", "calibration"}, "which of them"
