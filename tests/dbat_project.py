"""A small project of the Damped Bundle Adjustment Toolbox, written here with a known solution.

Five images of two strips over flat ground, in the files and the words of its own examples.
"""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

NOISE_PX = 0.02
"""The height of a point of two images, 280 m apart and 1780 m below: 1.1 cm."""
FOCAL_MM = 123.9392
PIXEL_MM = 0.006
PRINCIPAL_MM = (26.577, 38.811)
SIZE_PX = (8858, 12996)
IMAGES = ("8811.jpg", "8936.jpg", "8937.jpg", "8938.jpg", "9111.jpg")
CHECKS = ("351", "410")
SEEN_ONCE = "317"
"""A control point with a mark in the first image alone."""

SCRIPT = """<?xml version="1.0" encoding="UTF-8"?>
<document dbat_script_version="1.0">
  <input base_dir="$HERE">
    <ctrl_pts>
      <file format="id,label,x,y,z,sx,sy,sz">reference/sxb-control.txt</file>
      <filter id="351,410">remove</filter>
    </ctrl_pts>
    <check_pts>
      <file format="id,label,x,y,z,sx,sy,sz">reference/sxb-control.txt</file>
      <filter id="351,410">keep</filter>
    </check_pts>
    <images image_base_dir="$DBAT">
      <file format="id,path">images/images.txt</file>
    </images>
    <image_pts>
      <file format="id,im,x,y" sxy="0.5">measurements/markpts.txt</file>
      <file format="id,im,x,y" sxy="1.0">measurements/smartpts.txt</file>
    </image_pts>
    <cameras>
      <camera>
        <name>Aerial camera</name>
        <unit>mm</unit>
        <sensor>53.14800,77.97600</sensor>
        <image>8858,12996</image>
        <focal>123</focal>
        <cc>123.9392</cc>
        <pp>26.5770,38.8110</pp>
        <K>0,0,0</K>
        <P>0,0</P>
        <model>3</model>
        <skew>0</skew>
        <aspect>1</aspect>
      </camera>
    </cameras>
  </input>
  <output>
    <files base_dir="$HERE">
      <report>
        <file>result/report.txt</file>
      </report>
    </files>
  </output>
</document>
"""


@dataclass(frozen=True)
class Written:
    """What is true of the project: object points by id, and its image points."""

    points: dict[str, np.ndarray]
    marks: pd.DataFrame


def write_project(folder):
    """The script `sxb.xml`, the four tables and the report that it names, beside it."""
    draw = np.random.default_rng(8)
    angles_deg = np.column_stack([draw.normal(0.0, 0.6, (5, 2)), [-89.9, 92.6, 91.8, 92.3, -90.2]])
    centres = np.array(
        [
            [999_700.0, 112_250.0, 1916.6],
            [999_720.0, 112_560.0, 1916.4],
            [1_000_000.0, 112_540.0, 1917.1],
            [1_000_270.0, 112_570.0, 1915.8],
            [1_000_010.0, 112_240.0, 1917.9],
        ]
    )
    control = ["317", "351", "375", "403", "410", "422", "428", "333"]
    control += ["347", "492", "552", "563", "590", "634", "651", "607"]
    names = [*control, *(str(number) for number in range(65_000, 65_500))]
    low = [999_500.0, 112_100.0, 136.0]
    high = [1_000_500.0, 112_700.0, 144.0]
    places = draw.uniform(low, high, (len(names), 3)).round(3)
    places[0] = [999_690.0, 112_260.0, 139.453]
    marks = seen(names, places, angles_deg, centres)
    noise = draw.normal(0.0, NOISE_PX, (len(marks), 2))
    marks[["x_px", "y_px"]] = (marks[["x_px", "y_px"]] + noise).round(4)
    points = dict(zip(names, places, strict=True))
    write_tables(folder, control, points, marks)
    report = report_of(angles_deg, centres, {name: points[name] for name in control})
    (folder / "report.txt").write_text(report, "utf-8")
    (folder / "sxb.xml").write_text(SCRIPT, "utf-8")
    return Written(points, marks)


def seen(names, places, angles_deg, centres):
    """Image points without noise, by image; of what one image alone sees only that control point.

    Omega, phi and kappa turn a camera with y up, which looks along -z, into the world.
    """
    parts = []
    f_px = FOCAL_MM / PIXEL_MM
    for number, (angles, centre) in enumerate(zip(angles_deg, centres, strict=True)):
        to_world = Rotation.from_euler("XYZ", angles, degrees=True)
        x, y, z = to_world.inv().apply(places - centre).T
        part = pd.DataFrame({"image": IMAGES[number], "point": names})
        part["x_px"] = PRINCIPAL_MM[0] / PIXEL_MM - f_px * x / z
        part["y_px"] = PRINCIPAL_MM[1] / PIXEL_MM + f_px * y / z
        within = part["x_px"].between(0.0, SIZE_PX[0]) & part["y_px"].between(0.0, SIZE_PX[1])
        parts.append(part[within])
    marks = pd.concat(parts, ignore_index=True)
    lone = (marks["point"] == SEEN_ONCE) & (marks["image"] == IMAGES[0])
    tied = marks.groupby("point")["image"].transform("size") > 1
    return marks[lone | (tied & (marks["point"] != SEEN_ONCE))].reset_index(drop=True)


def write_tables(folder, control, points: dict[str, np.ndarray], marks):
    """Images, control points, and the image points of control and of tie points."""
    lines = [f"{k}, data/written/images/{name}" for k, name in enumerate(IMAGES, start=1)]
    write_lines(folder / "images.txt", "# id, path", lines)
    lines = []
    for number, name in enumerate(control, start=1):
        x, y, z = points[name]
        lines.append(f"{name}, B{number}, {x:.3f}, {y:.3f}, {z:.3f}, 0.02, 0.02, 0.04")
    head = "# Id, Name, X, Y, Z, sigmaX, sigmaY, sigmaZ"
    write_lines(folder / "sxb-control.txt", head, lines)
    marked = marks["point"].isin(control)
    for name, part in {"markpts.txt": marks[marked], "smartpts.txt": marks[~marked]}.items():
        lines = []
        for row in part.itertuples():
            image = 1 + IMAGES.index(row.image)
            lines.append(f"{row.point}, {image}, {row.x_px:.4f}, {row.y_px:.4f}")
        write_lines(folder / name, "# id, image, x, y", lines)


def write_lines(path, head, lines):
    path.write_text("\n".join([head, *lines]) + "\n", "utf-8")


def report_of(angles_deg, centres, control: dict[str, np.ndarray]):
    """The parts of a report that say where cameras and control points are."""
    lines = ["Damped Bundle Adjustment Toolbox result file", "      Precisions:"]
    for number, name in enumerate(IMAGES):
        lines.append(f"            Photo {number + 1}: {name}")
        for word, value in zip(("Omega", "Phi", "Kappa"), angles_deg[number], strict=True):
            lines += [f"               {word}:", f"                  Value:     {value:.9f} deg"]
            lines += ["                  Deviation: 0.0209 deg"]
        for word, value in zip(("Xc", "Yc", "Zc"), centres[number], strict=True):
            lines += [f"               {word}:", f"                  Value:     {value:.6f} ou"]
            lines += ["                  Deviation: 0.465 ou"]
    lines += ["   Quality", "      Photographs", "   Control measurements"]
    for part, names in {"Prior": control, "Posterior": control}.items():
        lines.append(f"      {part}")
        lines.append("            id,            x,            y,       z, label")
        for name in names:
            x, y, z = control[name]
            lines.append(f"           {name},   {x:.3f},   {y:.3f}, {z:.3f}, B")
    lines.append("      Diff (pos=abs diff, std=rel diff)")
    return "\n".join(lines) + "\n"
