"""Values that are sound alone and do not go together: each is refused with what to do."""

import pytest
import yaml

BY_LOG = """
mission: {name: survey}
log: {path: a.bin}
observations: {path: o.csv}
cameras:
  nadir:
    width_px: 14000
    height_px: 10600
    f_px: 20000.0
    cx_px: 7000.0
    cy_px: 5300.0
    calibration: laboratory
mount: {nadir: {}}
events: {log: {nadir: {image: "{index}"}}}
ground: {height: 200.0, reference: msl}
output: {path: out}
"""
BY_TRAJECTORY = BY_LOG + "stations: {trajectory: {path: flight.pos, point: antenna}}"
BY_CSV = BY_LOG + "stations: {trajectory: {path: flight.csv, point: antenna, heights: ellipsoid}}"
BY_TABLE = """
mission: {name: survey}
observations: {path: o.csv}
cameras:
  nadir:
    width_px: 14000
    height_px: 10600
    f_px: 20000.0
    cx_px: 7000.0
    cy_px: 5300.0
    calibration: laboratory
stations:
  orientation:
    path: opk.csv
    angles: omega_phi_kappa
    frame: geographic
    heights: msl
    date: "2026-05-14"
ground: {height: 200.0, reference: msl}
output: {path: out}
"""
METRIC_TABLE = """
cameras.nadir:
  width_px: 11500
  height_px: 11500
  calibration: laboratory
  metric:
    focal_mm: 153.7
    pixel_um: [20.0, 20.0]
    format_mm: [230.0, 230.0]
    origin: image_centre
    axes: right up
    ppa_mm: [0.0, 0.0]
    table: {sense: distortion, by: field_angle_deg, rows: [[0.0, 0.0], [30.0, 1.0], [81.0, 2.0]]}
"""
TWO_CAMERAS_ONE_POINT = """
stations.trajectory.point: camera
cameras.oblique:
  width_px: 14000
  height_px: 10600
  f_px: 20000.0
  cx_px: 7000.0
  cy_px: 5300.0
  calibration: laboratory
mount.oblique: {}
"""


def changed(base, changes):
    """A mission with values in the place of others, which stand under dotted keys."""
    values = yaml.safe_load(base)
    for key, value in yaml.safe_load(changes).items():
        *sections, last = key.split(".")
        section = values
        for name in sections:
            section = section.setdefault(name, {})
        section[last] = value
    return values


@pytest.mark.parametrize("base", [BY_LOG, BY_TABLE], ids=["log", "table"])
def test_the_missions_that_are_spoilt_are_sound(load, base):
    load(base)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        (
            "atmosphere.surface: [{h_msl_m: 4.0, relative_humidity: 0.5}]",
            "atmosphere.surface[0]: relative_humidity needs temperature_c",
        ),
        (
            "atmosphere.surface: [{h_msl_m: 4.0, temperature_c: 5.0, time_utc: noon}]",
            "atmosphere.surface[0].time_utc: is not a time like 2026-05-14T10:20:00Z",
        ),
        (
            "atmosphere.surface: [{h_msl_m: 4.0, time_utc: 9999-12-31T23:59:59Z}]",
            "atmosphere.surface[0].time_utc: is not a time like 2026-05-14T10:20:00Z",
        ),
        (
            "atmosphere.surface: [{h_msl_m: 4.0, time_utc: 0001-01-01T00:00:00+23:59}]",
            "atmosphere.surface[0].time_utc: is not a time like 2026-05-14T10:20:00Z",
        ),
        (
            f"observations.path: {'o' * 300}.csv",
            "observations.path: is longer than a path can be",
        ),
        (
            "cameras.nadir.format: colmap",
            "cameras.nadir: format needs file",
        ),
        (
            "cameras.nadir: {file: c.json, pixel_origin: centre, calibration: laboratory}",
            "cameras.nadir: pixel_origin cannot be combined with file",
        ),
        ("cameras.nadir.camera: 1", "cameras.nadir.camera needs file, or a block"),
        (
            METRIC_TABLE,
            "metric.table.rows: radii, or angles of up to 80 degrees, grow from row to row",
        ),
        (
            "cameras.nadir.window.cabin: {pressure: 800.0, pressure_hpa: 800.0}",
            "pressure_hpa: is the same as pressure: give one of them",
        ),
        (
            "cameras.nadir.window: {shape: spherical, frame: body, normal: [0.0, 0.6, 0.8]}",
            "a spherical window has no frame and no normal",
        ),
        ("events: {log: {}}", "events: log needs at least one camera"),
        (
            'events: {positions: {nadir: {path: e.pos, image: "{index}", delay_s: 1.0}}}',
            "its positions belong to its times: delay_s needs times_only: true",
        ),
        (
            "ground.height: {points: p.csv, crs: EPSG:4326, columns: {latitude: lat, y: y}}",
            "columns: give either latitude and longitude, or x and y",
        ),
        (
            "ground: {height: {dem: dem.tif}, reference: relative}",
            "leave home_h_msl_m out",
        ),
        (
            "ground: {height: intersected, sigma_m: 1.0}",
            "height: intersected computes its own sigmas; leave sigma_m and sigma_column out",
        ),
        ("ground: {height: block}", "give it a format of colmap"),
        (
            "control: {path: c.csv, crs: EPSG:4326}",
            "control: give columns, crs and reference together",
        ),
        (
            "{control: c.csv, refraction.direction: apply}",
            "leave it out with refraction.direction: apply",
        ),
        (
            "observations.refraction: removed_by_other",
            "removing it again would count it twice",
        ),
        (
            "observations: {path: m, format: colmap, columns: {x_px: x}}",
            "observations: format: colmap names its columns itself; leave columns out",
        ),
        (
            "observations: {path: m, format: colmap, pixel_origin: centre}",
            "observations: format: colmap states the pixel origin itself",
        ),
    ],
)
def test_combinations_of_a_mission_by_its_log(invalid, changes, text):
    assert text in invalid(changed(BY_LOG, changes))


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ("crs: EPSG:25832", "crs is only for a CSV"),
        (
            "{point: imu, lever_arm_m: from_events}",
            "lever_arm_m: from_events begins at the antenna",
        ),
        (
            "{point: camera, lever_arm_m: [0.0, 0.0, 1.0]}",
            "with point: camera there is no lever arm",
        ),
        (
            "{lever_arm_m: [0.0, 0.0, 1.0], replaces: [height]}",
            "a lever arm or point: camera needs both position and height replaced",
        ),
        ("lever_arm_m: from_events", "from_events needs events.positions"),
    ],
)
def test_values_of_a_trajectory_that_do_not_go_together(invalid, changes, text):
    values = {f"stations.trajectory.{key}": v for key, v in yaml.safe_load(changes).items()}
    assert text in invalid(changed(BY_TRAJECTORY, yaml.safe_dump(values)))


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        (TWO_CAMERAS_ONE_POINT, "is possible for one camera, not for nadir, obl"),
        (
            'events: {positions: {nadir: {path: e.pos, image: "{index}"}}}',
            "times_only: true leaves them to the trajectory",
        ),
        ("events: null", "events is missing, and there is no stations.orientation"),
        ("mount: {}", "mount is missing, and there is no stations.orientation"),
    ],
)
def test_combinations_with_a_trajectory(invalid, changes, text):
    assert text in invalid(changed(BY_TRAJECTORY, changes))


COLUMNS = yaml.safe_load("""
- - '{x: x, y: y, z: z, latitude: a, longitude: b, height: c}'
  - 'columns: give either latitude, longitude, height or x, y, z'
- - '{x: x, y: y, z: z, roll: r, pitch: p, yaw: h, q_w: w, q_x: i, q_y: j, q_z: k}'
  - 'columns: give either roll, pitch, yaw or q_w, q_x, q_y, q_z'
- ['{x: x}', 'columns: x needs x, y, z']
- ['{latitude: lat}', 'latitude, longitude, height']
""")


@pytest.mark.parametrize(("columns", "text"), COLUMNS)
def test_columns_of_a_trajectory_that_exclude_each_other(invalid, columns, text):
    assert text in invalid(changed(BY_CSV, f"stations.trajectory.columns: {columns}"))


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        (
            'mount: {nadir: {attitude: "MNT[0]"}}',
            "mount.nadir.attitude names a channel, and there is no log",
        ),
        (
            "stations.trajectory: {path: flight.pos, point: antenna}",
            "leave stations.trajectory and events.positions out",
        ),
        (
            "{stations: {trajectory: {path: flight.pos, point: antenna, replaces: [position]}}, "
            "events: {csv: {path: e.csv}}, mount: {nadir: {}}}",
            "there is no log, so all values of the trajectory are used: remove the key "
            "stations.trajectory.replaces",
        ),
        (
            "stations.orientation.format: dji",
            "stations.orientation: format: dji has angles: roll_pitch_yaw, of the gimbal",
        ),
        (
            "stations.orientation: {path: m, format: colmap, frame: ecef, angles: omega_phi_kappa}",
            "format: colmap has its own angles, columns and cameras",
        ),
    ],
)
def test_combinations_of_a_mission_by_its_orientations(invalid, changes, text):
    assert text in invalid(changed(BY_TABLE, changes))
