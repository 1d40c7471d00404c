"""What a mission file need not state, each default with its reason; and units on the way in."""

import math
import typing

import pytest
import yaml

from tests.logs import REPOSITORY
from unbend.config.atmosphere import AtmosphereSection, SoundingSection, SurfaceSection
from unbend.config.cameras import CameraSection
from unbend.config.event_sources import CsvEvents, LogEvents
from unbend.config.ground import GroundSection
from unbend.config.keys import mission_keys
from unbend.config.local_frames import LocalOrigin
from unbend.config.logs import LogSection, NamedChannel
from unbend.config.mission_file import OutputSection, RefractionSection
from unbend.config.mounts import MountSection
from unbend.config.observation_table import ObservationsSection
from unbend.config.windows import WindowSection
from unbend.ingest.field_maps import STATED_UNITS
from unbend.ingest.registry import SUFFIXES

CAMERA = {
    "width_px": 1000,
    "height_px": 800,
    "f_px": 900.0,
    "cx_px": 500.0,
    "cy_px": 400.0,
    "calibration": "laboratory",
}


DEFAULTS = yaml.safe_load("""
atmosphere:
  standard: us1976  # the standard of the command line, too
  adjust: true  # it is what the program is for
  climatology: auto  # of place and season
  index: ciddor  # Ciddor 1996 is for all wavelengths of cameras
  wavelength_m: 0.55e-6  # the middle of the visible; the eye's maximum
  co2_ppm: 450.0  # that of Ciddor's standard air
  board_temperature: false  # a board is 10 K warmer than the air
sounding:
  format: auto
refraction:
  direction: remove  # apply is for planning
  method: spherical  # plane is 1 % off at 60 degrees
  radius_m: null  # the ellipsoid's in the azimuth of the ray
camera:
  pixel_origin: null  # that of the observations
  window: null
  principal_distance: null
# Straight down, the top of the image towards the nose; nothing is known of the errors.
mount:
  roll_deg: 0.0
  pitch_deg: 0.0
  yaw_deg: 0.0
  lever_arm_m: [0.0, 0.0, 0.0]
  sigma_tilt_deg: null
  sigma_yaw_deg: null
window:
  shape: plane
  frame: camera
  in_calibration: none
  normal: [0.0, 0.0, 1.0]  # square to the optical axis
log:
  max_gap_s: 2.0  # attitude at 10 Hz: twenty lost in a row
events_of_log:
  delay_s: 0.0
events_of_csv:
  delay_s: 0.0
observations:
  pixel_origin: corner  # COLMAP's
  refraction: none
columns:
  image: image
  point: point
  x_px: x_px
  y_px: y_px
  distance_m: null
columns_of_csv:
  time_utc: time_utc
output:
  batch_rows: 250000  # five batches in memory: 0.5 GB
""")

SECTIONS = {
    "atmosphere": AtmosphereSection(),
    "sounding": SoundingSection(path="a.csv"),
    "refraction": RefractionSection(),
    "camera": CameraSection.model_validate(CAMERA),
    "mount": MountSection(),
    "window": WindowSection(cabin="log"),
    "log": LogSection(path="a.bin"),
    "events_of_log": LogEvents(image="{n}"),
    "events_of_csv": CsvEvents(path="a.csv"),
    "observations": ObservationsSection(path="a.csv"),
    "columns": ObservationsSection(path="a.csv").columns,
    "columns_of_csv": CsvEvents(path="a.csv").columns,
    "output": OutputSection(path="out"),
}
"""Sections of which a mission file states only what it must."""


@pytest.mark.parametrize("section", DEFAULTS)
def test_what_is_not_stated(section):
    for key, value in DEFAULTS[section].items():
        default = getattr(SECTIONS[section], key)
        assert default == value, key
        assert type(default) is type(value), key


def test_the_ground_has_no_default_and_two_limits():
    for name in ("height", "reference"):
        assert GroundSection.model_fields[name].is_required()
    for height in (-600.0, 10_000.0):
        given = GroundSection.model_validate({"height": height, "reference": "relative"})
        assert given.constant_m == height
    for height in (-600.1, 10_000.1):
        with pytest.raises(ValueError, match="is not a ground height"):
            GroundSection.model_validate({"height": height, "reference": "msl"})


ORIGINS = yaml.safe_load("""
- [null, corner, 500.0]
- [null, centre, 500.5]
- [corner, centre, 500.0]
- [centre, corner, 500.5]
- [centre, centre, 500.5]
""")


@pytest.mark.parametrize(("of_camera", "of_table", "cx"), ORIGINS)
def test_the_origin_of_a_camera_goes_before_that_of_the_table(of_camera, of_table, cx):
    """COLMAP: the centre of the upper left pixel is (0.5, 0.5); OpenCV: it is (0, 0)."""
    section = CameraSection.model_validate(CAMERA | {"pixel_origin": of_camera})
    camera = section.interior_orientation_by(of_table)
    assert (camera.cx_px, camera.cy_px) == (cx, cx - 100.0)


def test_two_principal_distances_are_those_of_their_axes():
    distortion = {"k1": 0.1, "k2": 0.2, "k3": 0.3, "p1": 0.004, "p2": 0.005}
    section = CAMERA | {"fx_px": 901.0, "fy_px": 899.0, "distortion": distortion}
    del section["f_px"]
    camera = CameraSection.model_validate(section).interior_orientation
    assert (camera.fx_px, camera.fy_px) == (901.0, 899.0)
    assert (camera.width_px, camera.height_px) == (1000, 800)
    assert camera.distortion._asdict() == distortion


def test_a_mount_in_radians():
    section = MountSection(
        roll_deg=10.0,
        pitch_deg=20.0,
        yaw_deg=30.0,
        lever_arm_m=[1.0, 2.0, 3.0],
    )
    mount = section.mount
    assert mount.roll_rad == pytest.approx(0.17453292519943295, rel=1e-15)
    assert mount.pitch_rad == pytest.approx(0.3490658503988659, rel=1e-15)
    assert mount.yaw_rad == pytest.approx(0.5235987755982988, rel=1e-15)
    assert tuple(mount.lever_arm_m) == (1.0, 2.0, 3.0)


def test_what_is_known_of_a_mount_in_radians():
    """Without a sigma of its own, that of the yaw is that of the tilt."""
    tilt_alone = MountSection(sigma_tilt_deg=0.05).mount
    assert tilt_alone.sigma_tilt_rad == pytest.approx(8.726646259971648e-4, rel=1e-15)
    assert tilt_alone.sigma_yaw_rad == tilt_alone.sigma_tilt_rad
    both = MountSection(sigma_tilt_deg=0.05, sigma_yaw_deg=0.2).mount
    assert both.sigma_yaw_rad == pytest.approx(3.490658503988659e-3, rel=1e-15)


def test_an_origin_in_radians():
    origin = LocalOrigin(lat_deg=30.0, lon_deg=-60.0, h_ellipsoid_m=600.0).build()
    assert origin.lat_rad == pytest.approx(math.pi / 6.0)
    assert origin.lon_rad == pytest.approx(-math.pi / 3.0)
    assert origin.h_ellipsoid_m == 600.0


def test_a_station_in_si():
    section = SurfaceSection(
        h_msl_m=450.0,
        temperature_c=-3.5,
        pressure_hpa=966.2,
        relative_humidity=0.6,
        time_utc="2026-05-14T10:20:00+02:00",
    )
    assert section.temperature_k == pytest.approx(269.65)
    assert section.pressure_pa == pytest.approx(96_620.0)
    assert section.humidity == 0.6
    assert section.time_ns == 1_778_746_800_000_000_000  # 08:20 UTC
    without = SurfaceSection(h_msl_m=0.0, temperature_c=1.0, time_utc="2026-05-14T10:20:00")
    assert without.time_ns == 1_778_754_000_000_000_000  # without an offset: UTC
    assert math.isnan(without.pressure_pa)
    assert math.isnan(without.humidity)


def test_the_formats_of_logs_are_those_that_can_be_read():
    described = next(key.text for key in mission_keys() if key.path == "log.path")
    assert described is not None
    for suffix in (".bin", ".log", ".tlog", ".mcap", ".ulg"):
        assert suffix in SUFFIXES
    for suffix in SUFFIXES:
        assert suffix in described


def test_the_page_of_formats_names_every_extension_of_a_log():
    page = (REPOSITORY / "docs" / "pages" / "formats" / "index.md").read_text("utf-8")
    for suffix in SUFFIXES:
        assert f"`{suffix}`" in page


def test_the_units_of_a_channel_are_those_that_can_be_converted():
    annotation = NamedChannel.model_fields["unit"].annotation
    (literal,) = (arm for arm in typing.get_args(annotation) if arm is not type(None))
    assert set(typing.get_args(literal)) == set(STATED_UNITS)
