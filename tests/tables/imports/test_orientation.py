"""Tables of orientations that are read, and those that are refused with their line."""

from pathlib import Path

import numpy as np
import pytest

from tests.helpers import refused, with_code
from unbend.flight.stations import NO_TIME
from unbend.messages import Ledger
from unbend.tables.imports.stated import Stated
from unbend.tables.imports.user_tables import read_known_positions, read_orientation

NAMES = {
    "image": "image",
    "latitude": "lat",
    "longitude": "lon",
    "height": "h",
    "omega": "o",
    "phi": "p",
    "kappa": "k",
}
HEAD = "image,lat,lon,h,o,p,k\n"
ROW = "a,47.5,8.5,3000.5,1.0,-2.0,90.0\n"


def read(text, names=NAMES, unit="deg"):
    path = Path("block.csv")
    path.write_text(text, "utf-8")
    settings = Stated(columns=names, angle_unit=unit)
    ledger = Ledger()
    table = read_orientation(path, settings, ledger)
    return table, tuple(ledger)


def refusal(text, code, **options):
    with refused(code) as caught:
        read(text, **options)
    assert "block.csv" in caught.value.where
    return caught.value


@pytest.mark.parametrize(
    ("unit", "numbers"),
    [
        ("deg", "10,20,90"),
        ("grad", "11.1111111111,22.2222222222,100"),
        ("rad", "0.17453292520,0.34906585040,1.5707963268"),
    ],
)
def test_angles_in_each_unit_are_radians(unit, numbers):
    text = f"{HEAD}a,47.5,8.5,3000.5,{numbers}\n"

    table, notes = read(text, unit=unit)

    assert np.degrees(table.angles[0]) == pytest.approx([10.0, 20.0, 90.0], abs=1e-8)
    lat_rad, lon_rad, height_m = table.position[0]
    assert lat_rad == pytest.approx(np.radians(47.5))
    assert lon_rad == pytest.approx(np.radians(8.5))
    assert height_m == 3000.5
    assert table.time_ns.tolist() == [NO_TIME]
    assert table.camera is None
    assert notes == ()


def test_semicolons_the_camera_the_sigmas_and_the_time():
    names = NAMES | {
        "camera": "c",
        "time_utc": "t",
        "sigma_tilt": "st",
        "sigma_height_m": "sh",
    }
    text = (
        "image;lat;lon;h;o;p;k;c;t;st;sh\n"
        "a;47.5;8.5;3000;0;0;0;left;2026-05-14T10:00:00.25Z;0.5;0.1\n"
        "b;47.5;8.5;3000;0;0;0;right;later;;\n"
    )

    table, notes = read(text, names)

    assert table.camera.tolist() == ["left", "right"]
    assert table.time_ns.tolist() == [1_778_752_800_250_000_000, NO_TIME]
    assert table.sigmas["sigma_tilt_rad"] == pytest.approx([np.radians(0.5), np.nan], nan_ok=True)
    assert table.sigmas["sigma_height_m"] == pytest.approx([0.1, np.nan], nan_ok=True)
    (entry,) = notes
    assert entry.code == "ORIENTATION-TIME"
    assert entry.kind == "loss"
    assert entry.count == 1
    assert "line 3" in entry.what


def test_gps_week_and_seconds():
    names = NAMES | {"gps_week": "w", "gps_seconds": "s"}
    text = f"{HEAD.strip()},w,s\n{ROW.strip()},2200,18.5\n"

    table, _ = read(text, names)

    # 2022-03-06 00:00:00 of GPS is the start of week 2200, 18 s ahead of UTC.
    assert table.time_ns.tolist() == [1_646_524_800_500_000_000]


def test_what_is_empty_is_unknown():
    table, _ = read(HEAD + "a,,8.5,,,-2,90\n")
    assert np.isnan(table.position[0, [0, 2]]).all()
    assert np.isnan(table.angles[0, 0])


def test_a_column_that_is_not_there():
    text = HEAD.replace(",k", ",kap") + ROW
    error = refusal(text, "ORIENTATION-COLUMN")
    assert "stations.orientation.columns.kappa" in error.remedy


@pytest.mark.parametrize(
    "text",
    [
        "image;lat;lon;h;o;p;k\na;47,5;8,5;3000,5;1;-2;90\n",
        "image lat lon h o p k\na 47,5 8,5 3000,5 1 -2 90\n",
        "image\tlat\tlon\th\to\tp\tk\na\t47.5\t8.5\t3000.5\t1\t-2\t90\n",
        "# image lat lon h o p k\n  a   47.5 8.5   3000.5 1 -2 90  \n",
        "# Cameras (1)\n# image, lat, lon, h, o, p, k\na\t47.5\t8.5\t3000.5\t1\t-2\t90\n",
        "\ufeffimage|lat|lon|h|o|p|k\na|47.5|8.5|3000.5|1|-2|90\n",
        'image,lat,lon,h,o,p,k\na,"47°30\'0""N","8 deg 30\' 0"" E",3000.5,1,-2,90\n',
    ],
)
def test_every_form_of_a_table_is_the_same_table(text):
    plain, _ = read(HEAD + ROW)

    table, entries = read(text)

    assert table.image.tolist() == ["a"]
    assert table.position == pytest.approx(plain.position)
    assert table.angles == pytest.approx(plain.angles)
    assert not entries


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ("3000.5", "1e9", "beyond 100000: 1e+09"),
        ("3000.5", "1e308", "beyond 100000: 1e+308"),
        ("47.5", "1e400", "is not a number"),
        ("8.5", "4_7", "is not a number"),
        ("1.0", "1_0", "is not a number: '1_0'"),
        ("3000.5", '"3,000"', "'3,000'"),  # perhaps thousands
    ],
)
def test_numbers_that_cannot_be_are_refused_with_their_line(before, after, words):
    text = HEAD + ROW + ROW.replace("a,", "b,").replace(before, after)
    error = refusal(text, "ORIENTATION-NUMBER")
    assert words in error.what
    assert error.where.endswith("line 3")


def test_lines_are_counted_from_the_begin_of_the_file():
    head = "# Cameras\n\n# image, lat, lon, h, o, p, k\n"
    wrong = ROW.replace("1.0", "x")

    repeated = refusal(head + ROW + wrong, "ORIENTATION-REPEATED")
    assert "4, 5" in repeated.what

    wrong = wrong.replace("a,", "b,")
    no_number = refusal(head + ROW + wrong, "ORIENTATION-NUMBER")
    assert no_number.where.endswith("line 5")


def test_columns_of_a_table_without_a_head_have_numbers():
    """As orthority takes it."""
    names = dict(zip(NAMES, "1324567", strict=True))
    text = "a 8.5 47.5 3000.5 1 -2 90\nb 8.6 47.5 3000.5 1 -2 90\n"

    table, _ = read(text, names)

    assert table.image.tolist() == ["a", "b"]
    assert np.degrees(table.position[0, :2]) == pytest.approx([47.5, 8.5])
    error = refusal("a 8.5 47.5 1\nb 8.6 47.5 2\n", "ORIENTATION-COLUMN")
    assert "no header: its columns are named 1 to 4" in error.what


def test_the_table_of_opendronemap_has_the_names_of_its_manual():
    names = ("image", "latitude", "longitude", "height", "roll", "pitch", "yaw")
    text = (
        "EPSG:4326\n"
        "DJI_0028.JPG -91.99 46.84 198.6 45 -90 2\n"
        "DJI_0032.JPG -91.98 46.84 198.6 45 -90 2\n"
    )

    table, _ = read(text, dict(zip(names, names, strict=True)))

    assert np.degrees(table.position[0, :2]) == pytest.approx([46.84, -91.99])
    assert np.degrees(table.angles[0]) == pytest.approx([2, -90, 45])


def test_a_table_without_rows_and_none_at_all():
    refusal(HEAD, "ORIENTATION-EMPTY")
    refusal("", "ORIENTATION-CSV")


@pytest.mark.parametrize(
    ("kappa", "unit", "words"),
    [
        ("399.7", "deg", "is the unit grad?"),
        ("90.0", "rad", "is the unit deg?"),
        ("5300.0", "deg", ""),
    ],
)
def test_angles_of_another_unit_and_columns_of_something_else(kappa, unit, words):
    text = HEAD + ROW.replace("90.0", kappa)
    error = refusal(text, "ORIENTATION-UNIT", unit=unit)
    assert words in error.what
    assert ("is the unit" in error.what) == (words != "")


def test_latitude_and_longitude_swapped():
    text = HEAD + ROW.replace("47.5,8.5", "151.2,-33.9")
    assert "longitude exchanged?" in refusal(text, "ORIENTATION-POSITION").what


def test_latitude_is_not_exchanged_with_a_longitude_that_is_no_latitude():
    text = HEAD + ROW.replace("47.5,8.5", "151.2,-133.9")
    assert "exchanged" not in refusal(text, "ORIENTATION-POSITION").what


def test_places_of_a_projection():
    text = HEAD + ROW.replace("47.5,8.5", "5262000.0,612000.0")
    error = refusal(text, "ORIENTATION-POSITION")
    assert "exchanged" not in error.what
    assert "projected" in error.remedy


def test_quaternions_that_are_none():
    names = {
        "image": "i",
        "x": "x",
        "y": "y",
        "z": "z",
        "q_w": "qw",
        "q_x": "qx",
        "q_y": "qy",
        "q_z": "qz",
    }
    head = "i,x,y,z,qw,qx,qy,qz\n"

    table, _ = read(head + "a,1,2,3,0.0,0.6,0.8,0.0003\n", names)

    assert np.linalg.norm(table.angles[0]) == pytest.approx(1.0, abs=1e-15)
    assert table.position.tolist() == [[1.0, 2.0, 3.0]]

    text = head + "a,1,2,3,0,0.6,0.8,0\nb,1,2,3,0.5,0.6,0.8,0\n"
    error = refusal(text, "ORIENTATION-QUATERNION", names=names)
    assert error.where.endswith("line 3")
    assert "1.11803" in error.what


def test_known_positions():
    path = Path("known.csv")
    path.write_text("name,b,l,h\nx,47.0,8.0,2500\n", "utf-8")
    names = {
        "image": "name",
        "latitude": "b",
        "longitude": "l",
        "height": "h",
    }

    image, position = read_known_positions(path, names)

    assert image.tolist() == ["x"]
    assert np.degrees(position[0, :2]) == pytest.approx([47.0, 8.0])
    assert position[0, 2] == 2500.0
    with refused("ORIENTATION-COLUMN"):
        read_known_positions(path, names | {"height": "hoehe"})


OWN = (
    "image,camera,status,time_utc,lat_deg,lon_deg,h_ellipsoid_m,omega_deg,phi_deg,kappa_deg,"
    "sigma_horizontal_m,sigma_height_m,sigma_tilt_deg,sigma_yaw_deg"
)
OWN_ROW = "a,nadir,ok,2026-05-01 08:20:30.5Z,47.5,8.5,3000.5,1.0,-2.0,90.0,0.5,0.75,0.01,0.02"
OWN_TABLE = f"{OWN}\n{OWN_ROW}\n"
DEFAULTS = {name: name for name in NAMES}
UNSTATED = ("camera", "time_utc", "sigma_horizontal_m", "sigma_height_m", "sigma_tilt", "sigma_yaw")


def read_by_defaults(text, **options):
    path = Path("own.csv")
    path.write_text(text, "utf-8")
    settings = Stated(columns=DEFAULTS, heights="ellipsoid", **options)
    ledger = Ledger()
    return read_orientation(path, settings, ledger), ledger


def test_our_own_table_is_read_without_columns():
    plain, _ = read(HEAD + ROW)

    table, ledger = read_by_defaults(OWN_TABLE, unstated=UNSTATED)

    assert table.position == pytest.approx(plain.position)
    assert table.angles == pytest.approx(plain.angles)
    assert table.camera.tolist() == ["nadir"]
    assert table.time_ns[0] == 1777623630500000000
    assert table.sigmas["sigma_horizontal_m"].tolist() == [0.5]
    assert np.degrees(table.sigmas["sigma_yaw_rad"]) == pytest.approx([0.02])
    (names,) = with_code(ledger, "ORIENTATION-NAMES")
    assert "latitude from lat_deg" in names.what


def test_what_is_stated_is_not_taken_from_our_own_table():
    table, _ = read_by_defaults(OWN_TABLE, unstated=("camera",))
    assert table.time_ns.tolist() == [NO_TIME]
    assert table.sigmas == {}


def test_our_own_table_of_stations_without_times_has_none():
    text = OWN_TABLE.replace("2026-05-01 08:20:30.5Z", "")
    table, ledger = read_by_defaults(text, unstated=UNSTATED)
    assert table.time_ns.tolist() == [NO_TIME]
    assert {entry.code for entry in ledger} == {"ORIENTATION-NAMES"}


def test_our_own_table_in_one_frame_says_its_origin():
    names = ",x_m,y_m,z_m,origin_lat_deg,origin_lon_deg,origin_h_ellipsoid_m"
    text = f"{OWN}{names}\n{OWN_ROW},1,2,3,47.25,8.5,400\n"

    table, _ = read_by_defaults(text)

    assert np.degrees(table.frame.lat_rad) == pytest.approx(47.25)
    assert np.degrees(table.frame.lon_rad) == pytest.approx(8.5)
    assert table.frame.h_ellipsoid_m == 400.0


@pytest.mark.parametrize("column", ["camera", "status", *OWN.split(",")[-4:]])
def test_a_table_that_lacks_one_of_our_columns_is_not_our_own(column):
    text = OWN_TABLE.replace(column, "other")
    table, _ = read_by_defaults(text, unstated=("time_utc",))
    assert table.time_ns.tolist() == [NO_TIME]


@pytest.mark.parametrize(
    ("head", "settings"),
    [
        ("imageName,Latitude,Longitude,Height,Omega,Phi,Kappa", {}),
        ("PhotoID,lat,lng,h_ellipsoid_m,OMEGA,PHI,KAPPA", {}),
        ("Label,lat_deg,lon_deg,height,omega_grad,phi_grad,kappa_grad", {"angle_unit": "grad"}),
    ],
)
def test_usual_names_of_other_programs(head, settings):
    text = f"{head}\na,47.5,8.5,3000.5,1,-2,90\n"

    table, _ = read_by_defaults(text, **settings)

    assert np.degrees(table.position[0, :2]) == pytest.approx([47.5, 8.5])
    assert table.image.tolist() == ["a"]


@pytest.mark.parametrize(
    "head",
    [
        "image,lat,lat_deg,lon,height,omega,phi,kappa",  # which of both?
        "image,lat,x,lon,h_msl_m,omega,phi,kappa",  # above another surface than is stated
        "image,lat,x,lon,height,omega_grad,phi,kappa",
    ],
)
def test_names_that_do_not_decide_are_refusal(head):
    with refused("ORIENTATION-COLUMN"):
        read_by_defaults(f"{head}\na,47.5,47.5,8.5,3000.5,1,-2,90\n")
