"""Times of images from real small JPEG files and from exiftool's table."""

from pathlib import Path

import exifread
import numpy as np
import pytest
from PIL import Image
from PIL.TiffImagePlugin import IFDRational
from scipy.spatial.transform import Rotation

from tests.helpers import ns, refused, with_code
from unbend.messages import Ledger
from unbend.tables.imports.exif import (
    NO_TIME,
    read_gimbal_orientations,
    read_image_times,
)
from unbend.tables.imports.image_stamps import parse_time
from unbend.tables.imports.stated import Stated

EXIF = 0x8769
GPS = 0x8825
XMP_BEGIN = (
    '<x:xmpmeta xmlns:x="adobe:ns:meta/">'
    '<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
    '<rdf:Description xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/" '
)
ORIGINAL = 0x9003
OFFSET = 0x9011
SUBSEC = 0x9291
GPS_DATE = 0x001D
GPS_TIME = 0x0007
SMALL_IMAGE = Image.new("RGB", (8, 8))


def write_jpeg(
    name,
    original,
    subsec=None,
    offset=None,
    *,
    gps=None,
    xmp="",
):
    """A JPEG of 8 x 8 pixels with these tags, written by Pillow."""
    exif = Image.Exif()
    tags = {ORIGINAL: original, SUBSEC: subsec, OFFSET: offset}
    for tag, value in tags.items():
        if value is not None:
            exif.get_ifd(EXIF)[tag] = value
    if gps is not None:
        date, time = gps
        exif.get_ifd(GPS).update({GPS_DATE: date, GPS_TIME: time})
    path = Path(name)
    path.parent.mkdir(exist_ok=True)
    SMALL_IMAGE.save(path, exif=exif.tobytes(), xmp=xmp.encode())


def write_second(second, **tags):
    """A JPEG of 2026-05-01 10:20:30 local time and some seconds, called by these."""
    write_jpeg(f"{second}.jpg", f"2026:05:01 10:20:3{second}", **tags)


HERE = Path()
TABLE = Path("exif.csv")


def read(path=HERE, zone=""):
    """The times of images, and what was said by its codes."""
    ledger = Ledger()
    times = read_image_times(path, zone, ledger)
    return times, {entry.code: entry for entry in ledger}


def read_table(text):
    """The same of exiftool's table."""
    TABLE.write_text(text)
    return read(TABLE)


def test_sub_seconds_and_offset_of_a_jpeg():
    for i in range(6):
        write_second(i, subsec=f"{i}5", offset="+02:00")

    times, entries = read()

    assert times.file.tolist() == [f"{i}.jpg" for i in range(6)]
    assert times.is_utc
    for i in range(6):
        assert times.time_ns[i] == ns(f"2026-05-01T08:20:3{i}.{i}5")
    assert times.sigma_s.tolist() == pytest.approx([0.005] * 6)
    assert not entries


@pytest.mark.parametrize("subsec", [None, "00", "000"])
def test_without_sub_seconds_half_a_second_is_the_sigma(subsec):
    for i in range(6):
        write_second(i, subsec=subsec)

    times, entries = read()

    assert not times.is_utc
    assert times.sigma_s.tolist() == [0.5] * 6
    assert entries["EXIF-WHOLE-SECONDS"].count == 6


def test_a_zone_is_inferred_where_gps_stamps_prove_it():
    for i in range(4):
        stamp = (8.0, 20.0, 29.5 + i)
        write_second(i, subsec="25", gps=("2026:05:01", stamp))

    times, entries = read()

    assert times.is_utc
    assert times.time_ns[0] == ns("2026-05-01T08:20:30.25")
    assert "+2 h" in entries["EXIF-ZONE"].what


def test_a_zone_is_not_inferred_where_gps_stamps_disagree():
    for i in range(4):
        stamp = (8.0 + i % 2, 27.0, 30.0 + i)
        write_second(i, subsec="25", gps=("2026:05:01", stamp))

    times, entries = read()

    assert not times.is_utc
    assert times.time_ns[0] == ns("2026-05-01T10:20:30.25")
    assert "EXIF-ZONE" not in entries


def test_a_stated_zone_holds_for_times_without_an_offset_only():
    write_second(0, subsec="5", offset="+01:00")
    write_second(1, subsec="5")

    times, _ = read(zone="-03:30")

    assert times.time_ns.tolist() == [
        ns("2026-05-01T09:20:30.5"),
        ns("2026-05-01T13:50:31.5"),
    ]


def test_djis_utc_at_exposure_is_the_first_choice():
    xmp = (
        XMP_BEGIN + 'drone-dji:UTCAtExposure="2026:05:01 08:20:30.123456" '
        'drone-dji:GimbalYawDegree="+12.30"/></rdf:RDF></x:xmpmeta>'
    )
    write_jpeg("DJI_0001.JPG", "2026:05:01 11:00:00", xmp=xmp)

    times, _ = read()

    assert times.is_utc
    assert times.time_ns[0] == ns("2026-05-01T08:20:30.123456")


def test_images_without_time_and_damaged_ones_are_counted_and_named():
    write_jpeg("a.jpg", "2026:05:01 10:20:30", "5")
    write_jpeg("b.jpg", None)
    write_jpeg("c.jpg", "0000:00:00 00:00:00")
    write_jpeg("d.jpg", "2026:02:30 10:20:30")
    whole = Path("a.jpg").read_bytes()
    Path("e.jpg").write_bytes(b"no image")
    Path("f.jpg").write_bytes(whole[:60])
    Path("notes.txt").write_text("2026:05:01 10:20:30")

    times, entries = read()

    assert times.file.tolist() == [f"{name}.jpg" for name in "abcdef"]
    assert times.time_ns[0] != NO_TIME
    assert (times.time_ns[1:] == NO_TIME).all()
    lost = entries["EXIF-TIME"]
    assert lost.kind == "loss"
    assert lost.count == 5
    assert "b.jpg, c.jpg, d.jpg" in lost.what


def test_a_local_time_among_times_in_utc_is_none():
    for i in range(3):
        write_second(i, subsec="5", offset="+02:00")
    write_second(9, subsec="5")

    times, entries = read()

    assert times.time_ns[3] == NO_TIME
    assert "9.jpg" in entries["EXIF-TIME"].what


def test_exiftools_table():
    text = (
        "SourceFile,FileName,EXIF:DateTimeOriginal,EXIF:SubSecTimeOriginal,OffsetTimeOriginal\n"
        "./left/DSC_1.JPG,DSC_1.JPG,2026:05:01 10:20:30,04,+02:00\n"
        "./left/DSC_2.JPG,DSC_2.JPG,2026:05:01 10:20:32.5,,+02:00\n"
        "./left/DSC_3.JPG,DSC_3.JPG,,,\n"
    )

    times, entries = read_table(text)

    assert times.time_ns[0] == ns("2026-05-01T08:20:30.04")
    assert times.time_ns[1] == ns("2026-05-01T08:20:32.5")
    assert entries["EXIF-TIME"].count == 1
    rows = times.rows_of(["dsc_2.tif", "left/DSC_3", "DSC_9.jpg"])
    assert rows == {"dsc_2.tif": 1, "left/DSC_3": 2}


@pytest.mark.parametrize(
    ("columns", "values", "expected"),
    [
        ("gps_week,gps_seconds", "2416,462030.5", "2026-05-01T08:20:12.5"),
        ("unix_time", "1777623630.25", "2026-05-01T08:20:30.25"),
        ("time_utc", "2026-05-01T08:20:30.25", "2026-05-01T08:20:30.25"),
        ("timestamp", "2026-05-01T08:20:30+02:00", "2026-05-01T06:20:30"),
        ("SubSecDateTimeOriginal", "2026:05:01 08:20:30.5Z", "2026-05-01T08:20:30.5"),
        ("GPSDateStamp,GPSTimeStamp", "2026:05:01,08:20:30", "2026-05-01T08:20:30"),
    ],
)
def test_other_times_in_a_table(columns, values, expected):
    """GPS week 2416 began on Sunday 2026-04-26; 462030.5 s is Friday 8:20:30.5, 18 leap seconds."""
    times, _ = read_table(f"FileName,{columns}\nDSC_1.JPG,{values}\n")
    assert times.is_utc
    assert times.time_ns.tolist() == [ns(expected)]


def test_a_name_in_two_folders_is_told_apart_by_its_folder():
    for folder in ("left", "right"):
        write_jpeg(f"{folder}/DSC_1.JPG", "2026:05:01 10:20:30", "5")
    times, _ = read()
    assert times.rows_of(["right/DSC_1.JPG"]) == {"right/DSC_1.JPG": 1}
    with refused("IMAGES-DUPLICATE"):
        times.rows_of(["DSC_1.JPG"])


def test_a_raw_image_and_its_jpeg_are_one():
    write_jpeg("DSC_1.JPG", "2026:05:01 10:20:30", "5")
    Path("DSC_1.NEF").write_bytes(b"raw")
    times, _ = read()
    assert times.file.tolist() == ["DSC_1.JPG"]


def test_no_images():
    with refused("IMAGES-NONE"):
        read()


@pytest.mark.parametrize(
    ("content", "code"),
    [
        (b"Name,DateTimeOriginal\na,b\n", "IMAGES-NONE"),
        (b"\xff\x81\x00", "IMAGES-CSV"),
    ],
)
def test_a_table_without_images_is_refused(content, code):
    TABLE.write_bytes(content)
    with refused(code):
        read(TABLE)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "    :  :     :  :  ",
        "2026:13:01 00:00:00",
        "1777623630250",
        "12:30",
        "2026:05:01",
        "2099:09:15 10:20:30",
        "1970:01:01 00:00:00",
        "2026:05:06 12:00:00+99:99",
        "2026:05:06 12:00:00+14:01",
        "2026:05:06 12:00:00-23:59",
        "9999:12:31 23:59:59Z",
        "0001:01:01 00:00:00Z",
    ],
)
def test_what_is_no_time(text):
    assert parse_time(text, "UTC") is None


@pytest.mark.parametrize("zone", ["+14:01", "-23:59"])
def test_a_zone_elsewhere_that_no_place_has(zone):
    assert parse_time("2026:05:06 12:00:00", zone) is None


DJI = XMP_BEGIN + (
    'drone-dji:GpsLatitude="-33.5" '
    'drone-dji:GpsLongtitude="+151.25" drone-dji:AbsoluteAltitude="+85.40" '
    'drone-dji:GimbalRollDegree="{}" drone-dji:GimbalPitchDegree="{}" '
    'drone-dji:GimbalYawDegree="{}"/></rdf:RDF></x:xmpmeta>'
)


def assert_place(position, latitude, longitude, height):
    assert np.degrees(position[:2]) == pytest.approx([latitude, longitude])
    assert position[2] == height


def test_positions_of_dji_and_of_exif():
    write_second(0, xmp=DJI.format(0, -90, 30))
    exif = Image.Exif()
    exif.get_ifd(GPS).update(
        {
            1: "N",
            2: (47.0, 18.0, 36.0),
            3: "W",
            4: (8.0, 30.0, 0.0),
            5: b"\x01",  # below the sea
            6: 12.5,
        }
    )
    SMALL_IMAGE.save("1.jpg", exif=exif.tobytes())
    write_second(2)

    times, _ = read()

    of_dji, of_exif, nowhere = times.position
    assert_place(of_dji, -33.5, 151.25, 85.4)
    assert_place(of_exif, 47.31, -8.5, -12.5)
    assert np.isnan(nowhere).all()


def test_positions_of_exiftool():
    text = (
        "SourceFile,DateTimeOriginal,GPSLatitude,GPSLongitude,GPSAltitude\n"
        'x.jpg,2026:05:01 10:20:30,"47 deg 18\' 36.00"" N","8 deg 30\' 0.00"" W",'
        "12.5 m Above Sea Level\ny.jpg,2026:05:01 10:20:31,0,0,0\n"
    )

    times, _ = read_table(text)

    assert_place(times.position[0], 47.31, -8.5, 12.5)
    assert np.isnan(times.position[1]).all()


def gimbal(path=HERE):
    """Bodies against north, east and down in which cameras are at rest, and the ledger by codes."""
    ledger = Ledger()
    table = read_gimbal_orientations(path, Stated(), ledger)
    # Angles alone are read: times are not, even where tags have them.
    assert (table.time_ns == NO_TIME).all()
    bodies = []
    for roll, pitch, yaw in table.angles:
        body = None
        if np.isfinite(roll):
            body = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
        bodies.append(body)
    return bodies, {entry.code: entry for entry in ledger}


SINE_OF_45 = np.sqrt(0.5)


def assert_looks_down_to_the_east(bodies):
    (body,) = bodies
    assert body[:, 2] == pytest.approx([0.0, SINE_OF_45, SINE_OF_45], abs=1e-9)


@pytest.mark.parametrize(
    ("angles", "axis", "top"),
    [
        (
            (0, -90, 30),
            (0.0, 0.0, 1.0),
            (np.sqrt(0.75), 0.5, 0.0),
        ),
        (
            (0, -45, 90),
            (0.0, SINE_OF_45, SINE_OF_45),
            (0.0, SINE_OF_45, -SINE_OF_45),
        ),
        (
            (180, -90, -150),
            (0.0, 0.0, 1.0),
            (np.sqrt(0.75), 0.5, 0.0),
        ),
    ],
)
def test_where_a_gimbal_looks(angles, axis, top):
    """North, east, down of the optical axis and of the top of the image, by hand."""
    write_second(0, xmp=DJI.format(*angles))
    write_second(1)

    (body, without_gimbal), _ = gimbal()

    assert body[:, 2] == pytest.approx(axis, abs=1e-9)
    assert body[:, 0] == pytest.approx(top, abs=1e-9)
    assert without_gimbal is None


TURNS = {"Roll": "0", "Pitch": "-45", "Yaw": "+90"}
ELEMENTS = "\n".join(
    f"<drone-dji:Gimbal{name}Degree>{turn}</drone-dji:Gimbal{name}Degree>"
    for name, turn in TURNS.items()
)
AS_ELEMENTS = XMP_BEGIN + f">\n{ELEMENTS}\n</rdf:Description></rdf:RDF></x:xmpmeta>"


@pytest.mark.parametrize(
    "xmp",
    [
        AS_ELEMENTS,  # as tag editors rewrite it
        AS_ELEMENTS.replace("drone-dji:", "ns1:").replace("xmlns:drone-dji", "xmlns:ns1"),
        AS_ELEMENTS.replace("drone-dji/1.0/", "drone-dji/1.1/"),
        '<?xpacket begin="\ufeff" id="W5M0MpCehiHzreSzNTczkc9d"?>' + AS_ELEMENTS + "   \n",
    ],
)
def test_xmp_is_read_however_it_is_written(xmp):
    write_second(0, xmp=xmp)
    bodies, entries = gimbal()
    assert_looks_down_to_the_east(bodies)
    assert not entries


def insert_segments(name, segments):
    """Put segments before all others of a JPEG."""
    path = Path(name)
    whole = path.read_bytes()
    path.write_bytes(whole[:2] + segments + whole[2:])


def test_xmp_behind_other_segments_of_a_megabyte_is_read():
    """As of a thermal camera, which has its raw values before the XMP."""
    write_second(0, xmp=AS_ELEMENTS)
    begin = b"\xff\xe3\xff\xff<x:xmpmeta>"
    segment = begin.ljust(2 + 65535, b"\0")
    insert_segments("0.jpg", 16 * segment)

    bodies, _ = gimbal()

    assert_looks_down_to_the_east(bodies)


EDITORS_PACKET = XMP_BEGIN + 'drone-dji:Model="M"/></rdf:RDF></x:xmpmeta>'


def with_packet_before(name, packet):
    """Put another segment of XMP before all others of a JPEG."""
    content = b"http://ns.adobe.com/xap/1.0/\0" + packet.encode()
    length = len(content) + 2
    insert_segments(name, b"\xff\xe1" + length.to_bytes(2, "big") + content)


def test_all_packets_of_xmp_are_read():
    """An editor that does not know the camera's XMP writes its own before it."""
    write_second(0, xmp=AS_ELEMENTS)
    with_packet_before("0.jpg", EDITORS_PACKET)
    bodies, entries = gimbal()
    assert_looks_down_to_the_east(bodies)
    assert not entries


def test_packets_of_xmp_that_contradict_are_a_loss():
    write_second(0, xmp=AS_ELEMENTS)
    other = EDITORS_PACKET.replace('Model="M"', 'GimbalYawDegree="12.5"')
    with_packet_before("0.jpg", other)
    _, entries = read()
    assert "GimbalYawDegree twice" in entries["EXIF-UNREADABLE"].what


def test_xmp_of_a_tiff_is_read():
    tags = {700: AS_ELEMENTS.encode()}
    image = Image.new("RGB", (400, 400))
    image.save("a.tif", tiffinfo=tags)

    bodies, _ = gimbal()

    assert_looks_down_to_the_east(bodies)


@pytest.mark.parametrize(
    ("xmp", "why"),
    [
        ('<!DOCTYPE x [<!ENTITY a "1">]>' + AS_ELEMENTS, "document type"),
        (AS_ELEMENTS.replace("</rdf:RDF>", ""), "is not XML"),
        (
            AS_ELEMENTS.replace('xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/" ', ""),
            "unbound",
        ),
    ],
)
def test_xmp_that_is_none_is_a_loss_and_its_exif_is_read(xmp, why):
    write_second(0, xmp=xmp)
    times, entries = read()
    assert times.time_ns.tolist() == [ns("2026-05-01T10:20:30")]
    assert why in entries["EXIF-UNREADABLE"].what


def test_xmp_without_an_end_is_a_loss():
    tiff = b"II*\0\x08\0\0\0\0\0\0\0\0\0" + AS_ELEMENTS[:300].encode()
    Path("a.tif").write_bytes(tiff)
    ledger = Ledger()
    read_image_times(HERE, "", ledger)
    losses = with_code(ledger, "EXIF-UNREADABLE")
    assert any("no end" in entry.what for entry in losses)


GIMBAL_HEAD = "SourceFile{0}GPSLatitude{0}GPSLongitude{0}AbsoluteAltitude{0}"
GIMBAL_HEAD += "GimbalRollDegree{0}GimbalPitchDegree{0}GimbalYawDegree\n"


@pytest.mark.parametrize(
    "text",
    [
        GIMBAL_HEAD.format(";") + "a.jpg;46,5;7,25;3000,3;2,3e-05;-89,9;90\n",
        GIMBAL_HEAD.format("\t") + "a.jpg\t46 deg 30' 0.0\" N\t7,25\t3000,3 m\t0\t-89,9\t90\n",
        "\ufeffsep=;\r\n" + GIMBAL_HEAD.format(";") + "a.jpg;46,5;7,25;3000,3;0;-89,9;90\r\n",
    ],
)
def test_tags_of_spreadsheets_are_read_as_numbers(text):
    TABLE.write_text(text, "utf-8")

    table = read_gimbal_orientations(TABLE, Stated(), Ledger())
    (body,), _ = gimbal(TABLE)

    assert_place(table.position[0], 46.5, 7.25, 3000.3)
    tilt = np.radians(0.1)
    assert body[:, 2] == pytest.approx([0.0, np.sin(tilt), 1.0], abs=2e-6)


def test_tags_that_are_no_numbers_are_losses():
    """Thousands, and what a translated tag reader writes, are not read in part."""
    text = GIMBAL_HEAD.format(",")
    text += 'a.jpg,46.5,7.5,"1,234",0,-90,0\nb.jpg,46.5,7.5,3000.0,0,abwärts,0\n'
    TABLE.write_text(text, "utf-8")
    ledger = Ledger()
    table = read_gimbal_orientations(TABLE, Stated(), ledger)
    assert np.isnan(table.position[0, 2])
    assert np.isnan(table.angles[1]).all()
    of_angles, of_position = with_code(ledger, "IMAGES-TAG")
    assert of_angles.kind == of_position.kind == "loss"
    assert "a.jpg: '1,234'" in of_position.what
    assert "b.jpg: 'abwärts'" in of_angles.what


def test_hemispheres_of_tags_are_compared():
    """One that contradicts the tag's own, or belongs to the other axis, leaves no position."""
    text = (
        "SourceFile,GPSLatitude,GPSLatitudeRef,GPSLongitude,DateTimeOriginal\n"
        "a.jpg,46.5,South,7.5 E,2026:05:01 10:20:30\n"
        "b.jpg,46.5 N,S,7.5 E,2026:05:01 10:20:30\n"
        "c.jpg,7.5 E,,46.5 N,2026:05:01 10:20:30\n"
    )

    times, entries = read_table(text)

    assert np.degrees(times.position[0, :2]) == pytest.approx([-46.5, 7.5])
    assert np.isnan(times.position[1:]).all()
    assert entries["IMAGES-TAG"].kind == "loss"


@pytest.mark.parametrize(
    ("tag", "height"),
    [
        ("AbsoluteAltitude", 600.5),
        ("GPSAltitude", -600.5),
    ],
)
def test_djis_height_has_a_sign_of_its_own(tag, height):
    """GPSAltitudeRef belongs to GPSAltitude alone; some drones write it below the sea."""
    text = (
        f"SourceFile,GPSLatitude,GPSLongitude,{tag},GPSAltitudeRef\n"
        "a.jpg,46.5,7.5,600.5,Below Sea Level\n"
    )
    times, _ = read_table(text)
    assert times.position[0, 2] == height


def test_images_none_of_whose_tags_can_be_read_are_refused():
    text = "SourceFile,GimbalRollDegree,GimbalPitchDegree,GimbalYawDegree\na.jpg,x,y,z\nb.jpg,,,\n"
    TABLE.write_text(text)
    with refused("IMAGES-TAG"):
        read_gimbal_orientations(TABLE, Stated(), Ledger())


def test_images_without_gimbal_are_refused():
    write_second(0)
    with refused("IMAGES-NO-GIMBAL"):
        read_gimbal_orientations(HERE, Stated(), Ledger())


def test_a_damaged_file_is_a_loss_with_what_the_library_said(monkeypatch):
    write_second(0)
    write_second(1)
    whole = exifread.process_file

    def process(file, **options):
        if file.name.endswith("1.jpg"):
            raise ValueError("unknown type in tag 0x9003")
        return whole(file, **options)

    monkeypatch.setattr(exifread, "process_file", process)
    _, entries = read()
    assert "1.jpg (ValueError: unknown type in tag 0x9003)" in entries["EXIF-UNREADABLE"].what


def test_a_time_of_0_over_0_is_no_time_of_that_image_alone():
    """As cameras write it that have no fix."""
    stamps = [(10.0, 20.0, 30.0 + i) for i in range(4)]
    stamps[2] = (IFDRational(0, 0),) * 3
    for i, stamp in enumerate(stamps):
        write_jpeg(f"IMG_{i}.JPG", None, gps=("2026:05:01", stamp))

    times, entries = read()

    expected = [ns(f"2026-05-01T10:20:3{i}") for i in range(4)]
    expected[2] = NO_TIME
    assert times.time_ns.tolist() == expected
    assert entries["EXIF-TIME"].kind == "loss"
    assert entries["EXIF-TIME"].count == 1
