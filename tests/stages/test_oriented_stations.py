"""Missions whose stations come from an oriented block: the answer is that of the log's stations."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest
import yaml

pytestmark = pytest.mark.usefixtures("plain_report")

CABIN = {"pressure_hpa": 812.0, "temperature_c": 21.0, "relative_humidity": 0.3}
UNDULATION_M = 47.6
A, E2 = 6378137.0, 0.00669437999014


def textbook_matrix(q) -> np.ndarray:
    """(n, 3, 3) of v_camera = R(q) v_enu by the formula, not by a library."""
    w, x, y, z = np.asarray(q).T
    return np.stack([
        np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], -1),
        np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], -1),
        np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], -1),
    ], -2)  # fmt: skip


def textbook_opk(matrix: np.ndarray) -> np.ndarray:
    """(n, 3) degrees, from the elements of M (camera x right, y up to world)."""
    m = matrix.transpose(0, 2, 1) * [1.0, -1.0, -1.0]
    omega = np.arctan2(-m[:, 1, 2], m[:, 2, 2])
    phi = np.arcsin(m[:, 0, 2])
    kappa = np.arctan2(-m[:, 0, 1], m[:, 0, 0])
    return np.degrees(np.stack([omega, phi, kappa], axis=1))


def earth_centred(lat_deg, lon_deg, h) -> tuple[np.ndarray, np.ndarray]:
    """(n, 3) coordinates and (n, 3, 3) from them to east, north, up, written out here."""
    p, lon = np.radians(lat_deg), np.radians(lon_deg)
    n = A / np.sqrt(1 - E2 * np.sin(p) ** 2)
    xyz = np.stack([(n + h) * np.cos(p) * np.cos(lon), (n + h) * np.cos(p) * np.sin(lon),
                    (n * (1 - E2) + h) * np.sin(p)], -1)  # fmt: skip
    zero = np.zeros_like(p)
    enu = np.stack([
        np.stack([-np.sin(lon), np.cos(lon), zero], -1),
        np.stack([-np.sin(p) * np.cos(lon), -np.sin(p) * np.sin(lon), np.cos(p)], -1),
        np.stack([np.cos(p) * np.cos(lon), np.cos(p) * np.sin(lon), np.sin(p)], -1),
    ], -2)  # fmt: skip
    return xyz, enu


@pytest.fixture(scope="module")
def by_log(mission_factory, tmp_path_factory):
    """The mission by its log, in the standard atmosphere behind windows of constant air."""
    mission = mission_factory(tmp_path_factory.mktemp("by_log") / "mission")
    mission.config["atmosphere"] = {"adjust": False}
    for camera in mission.config["cameras"].values():
        camera["window"] = {"cabin": CABIN}
    ended = mission.run()
    assert ended.code == 0, ended.text
    return mission


@pytest.fixture
def block(mission_factory, by_log, tmp_path):
    """The same without its log: a table of its stations, which a test writes."""
    mission = mission_factory(tmp_path / "mission")
    mission.config = yaml.safe_load(yaml.safe_dump(by_log.config))
    for section in ("log", "mount", "events"):
        del mission.config[section]
    mission.config["mission"]["undulation_m"] = UNDULATION_M
    mission.table = by_log.stations().to_pandas()
    mission.config["stations"] = {
        "orientation": {
            "path": "block.csv", "angles": "omega_phi_kappa", "frame": "geographic",
            "heights": "msl", "columns": {"camera": "camera", "time_utc": "time"},
        }
    }  # fmt: skip
    mission.config["output"]["path"] = "block"
    return mission


def columns_of(table: pd.DataFrame, digits: int = 9) -> pd.DataFrame:
    """image, camera, time, latitude, longitude, height above sea level, omega, phi, kappa."""
    opk = textbook_opk(textbook_matrix(table[["q_w", "q_x", "q_y", "q_z"]])).round(digits)
    time = pd.to_datetime(table["time_utc"]).dt.strftime("%Y-%m-%dT%H:%M:%S.%fZ")
    return pd.DataFrame({
        "image": table["image"], "camera": table["camera"], "time": time,
        "latitude": table["lat_deg"].round(digits), "longitude": table["lon_deg"].round(digits),
        "height": table["h_msl_m"].round(4),
        "omega": opk[:, 0], "phi": opk[:, 1], "kappa": opk[:, 2],
    })  # fmt: skip


def write(mission, table: pd.DataFrame, name: str = "block.csv") -> None:
    table.to_csv(mission.folder / name, index=False)


def ran(mission, exit_code: int = 0) -> dict:
    ended = mission.run()
    assert ended.code == exit_code, ended.text
    return json.loads((mission.output / "manifest.json").read_text(encoding="utf-8"))


def shift(mission) -> np.ndarray:
    table = mission.results()
    return np.stack([table[f"{axis}_corrected_px"].to_numpy() - table[f"{axis}_px"].to_numpy()
                     for axis in "xy"], axis=1)  # fmt: skip


def assert_same(block, by_log, atol: float = 2e-6) -> None:
    """Every correction is that of the log; refraction alone is up to a pixel here."""
    assert np.abs(shift(by_log)).max() > 0.3
    np.testing.assert_allclose(shift(block), shift(by_log), atol=atol)


def refused(mission, code: str) -> str:
    ended = mission.run()
    assert ended.code in (2, 6), ended.text
    assert code in ended.err, ended.text
    assert "Traceback" not in ended.text
    return ended.err


def test_without_a_log_the_corrections_are_those_of_the_log(block, by_log):
    write(block, columns_of(block.table))
    manifest = ran(block)
    assert_same(block, by_log)
    assert manifest["log"] is None
    assert manifest["channels"] == {}
    assert {item["role"] for item in manifest["inputs"]} == {"orientation", "observations"}
    mine, theirs = block.stations().to_pandas(), by_log.stations().to_pandas()
    assert mine["time_utc"].tolist() == theirs["time_utc"].dt.floor("us").tolist()
    np.testing.assert_allclose(mine["h_ellipsoid_m"], theirs["h_ellipsoid_m"], atol=0.02)
    assert mine["sigma_height_m"].isna().all()


def test_a_coarse_table_is_as_good_as_its_digits(block, by_log):
    write(block, columns_of(block.table, digits=3))  # 0.001 deg of tilt: 2 parts in 10,000
    block.config["stations"]["orientation"]["columns"]["camera"] = "camera"
    ran(block)
    relative = np.abs(shift(block) - shift(by_log)).max() / np.abs(shift(by_log)).max()
    assert 1e-7 < relative < 3e-4


@pytest.mark.parametrize(
    ("unit", "turn"), [("grad", 400.0), ("rad", 2.0 * np.pi)], ids=["grad", "rad"]
)
def test_other_units(block, by_log, unit, turn):
    table = columns_of(block.table, 12)
    table[["omega", "phi", "kappa"]] *= turn / 360.0
    write(block, table)
    block.config["stations"]["orientation"]["unit"] = unit
    ran(block)
    assert_same(block, by_log)


def test_quaternions_and_their_inverse(block, by_log):
    table = columns_of(block.table)
    q = block.table[["q_w", "q_x", "q_y", "q_z"]]
    write(block, table.join(q))
    orientation = block.config["stations"]["orientation"]
    orientation["angles"] = "quaternion"
    ran(block)
    assert_same(block, by_log)
    write(block, table.join(q * [1.0, -1.0, -1.0, -1.0]))
    orientation["angles"] = "quaternion_to_frame"
    ran(block)
    assert_same(block, by_log)


def test_earth_centred(block, by_log):
    table = columns_of(block.table)
    xyz, enu = earth_centred(block.table["lat_deg"], block.table["lon_deg"],
                             block.table["h_ellipsoid_m"].to_numpy())  # fmt: skip
    opk = textbook_opk(textbook_matrix(block.table[["q_w", "q_x", "q_y", "q_z"]]) @ enu)
    table[["x", "y", "z"]], table[["omega", "phi", "kappa"]] = xyz.round(4), opk
    write(block, table.drop(columns=["latitude", "longitude", "height"]))
    orientation = block.config["stations"]["orientation"]
    orientation["frame"] = "ecef"
    del orientation["heights"]
    ran(block)
    assert_same(block, by_log, atol=2e-5)


def test_one_topocentric_frame_100_km_away(block, by_log):
    """Its vertical is 0.9 deg off at the stations: 3 % of the refraction."""
    lat0, lon0, h0 = 46.6, 8.9, 500.0
    xyz, enu = earth_centred(block.table["lat_deg"], block.table["lon_deg"],
                             block.table["h_ellipsoid_m"].to_numpy())  # fmt: skip
    origin, axes = earth_centred(np.array([lat0]), np.array([lon0]), np.array([h0]))
    matrix = textbook_matrix(block.table[["q_w", "q_x", "q_y", "q_z"]]) @ enu @ axes[0].T
    table = columns_of(block.table)
    table[["x", "y", "z"]] = ((xyz - origin[0]) @ axes[0].T).round(4)
    table[["omega", "phi", "kappa"]] = textbook_opk(matrix)
    write(block, table)
    orientation = block.config["stations"]["orientation"]
    orientation["frame"] = {"enu": {"lat_deg": lat0, "lon_deg": lon0, "h_ellipsoid_m": h0}}
    del orientation["heights"]
    ran(block)
    assert_same(block, by_log, atol=2e-5)
    # The same angles beside latitude, longitude and height.
    orientation["heights"] = "msl"
    orientation["columns"] |= {"latitude": "latitude"}
    ran(block)
    assert_same(block, by_log, atol=2e-5)
