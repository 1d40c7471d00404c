"""Reports in millimetres: published ones, an independent chain of formulas, and what is refused."""

import numpy as np
import pytest

from tests.helpers import refused
from tests.refraction.comparing import assert_near
from unbend.errors import PhysicsError
from unbend.refraction.calibration import MetricReport, camera_of_report

# USGS reports OSL/2985 (Wild RC30, 15/4 UAG-S 13413) and OSL/3030 (RC30, 13365): calibrated focal
# length [mm], coefficients that correct, symmetric radial distortion [um] by field angle.
ANGLES = [7.5, 15.0, 22.7, 30.0, 35.0, 40.0]
OSL_2985 = (
    153.743,
    {"k0": 0.2616e-4, "k1": -0.2295e-8, "k2": 0.1454e-13, "p1": -0.3015e-7, "p2": 0.1668e-7},
    [-1.0, -1.0, -1.0, -1.0, 0.0, 1.0],
)
OSL_3030 = (
    153.247,
    {"k0": 0.3285e-4, "k1": -0.5215e-8, "k2": 0.1642e-12, "p1": -0.1218e-7, "p2": -0.4426e-7},
    [-1.0, -1.0, -1.0, 0.0, 1.0, 1.0],
)
SCAN = {
    "pixel_mm": (0.02, 0.02),
    "format_mm": (230.0, 230.0),
    "origin_px": (5760.0, 5745.0),
    "axes": "right up",
    "ppa_mm": (0.004, -0.012),
    "ppbs_mm": (-0.009, 0.002),
}
SIZE = (11500, 11500)


def metric_camera(focal_mm, *, size=SIZE, **fields):
    return camera_of_report(MetricReport(focal_mm, **fields), size)


@pytest.mark.parametrize(
    "report",
    [OSL_2985, OSL_3030],
    ids=["OSL/2985", "OSL/3030"],
)
def test_coefficients_that_correct_agree_with_the_table_of_the_distortion(report):
    focal, coefficients, radial_um = report
    radii_mm = focal * np.tan(np.radians(ANGLES))
    radial_mm = np.array(radial_um) * 1e-3
    table = np.stack([radii_mm, radial_mm], axis=1)
    fields = SCAN | {"coefficients": coefficients, "sense": "correction"}
    metric_camera(focal, **fields, table=(table, "distortion"))
    with refused("CAMERA-REPORT", PhysicsError) as refusal:
        metric_camera(focal, **fields, table=(table, "correction"))
    assert refusal.match(r"coefficients differ by 2\.\d um at a radius")


def test_one_point_by_hand():
    """OSL/2985 at x = 100 mm: dr = 2.616 - 2.295 + 0.145 um, decentring 3 p1 x^2, p2 x^2."""
    focal, coefficients, _ = OSL_2985
    centred = SCAN | {"ppa_mm": (0.0, 0.0), "ppbs_mm": (0.0, 0.0)}
    fields = centred | {"coefficients": coefficients}
    camera = metric_camera(focal, **fields, sense="correction")
    x = np.array([5760.0 + 5000.0])
    y = np.array([5745.0])
    u, v, _ = camera.rays(x, y)
    dx_um = 2.616 - 2.295 + 0.1454 - 3.0 * 0.3015
    assert_near(focal * u * 1e3 - 100e3, [dx_um], 1e-6)
    assert_near(-focal * v * 1e3, [0.1668], 1e-6)
    # As a distortion the same numbers move an ideal point there by the same to the other side.
    distorting = metric_camera(focal, **fields, sense="distortion")
    u = np.array([100.0 / focal])
    x, _ = distorting.project(u, np.zeros(1))
    assert_near((x - 5760.0) * 20.0 - 100e3, [dx_um], 1e-6)


PPA_MM = np.array([0.21, -0.13])
PPBS_MM = np.array([0.05, 0.08])
COEFFICIENTS = {
    "k0": 1e-4,
    "k1": -2e-7,
    "k2": 3e-11,
    "k3": -2e-15,
    "k4": 1e-19,
    "p1": 3e-6,
    "p2": -2e-6,
    "b1": 2e-4,
    "b2": -3e-4,
}


def moved(point):
    """Radial and decentring terms, about the principal point of symmetry."""
    *k, p1, p2, _, _ = COEFFICIENTS.values()
    x, y = point - PPBS_MM
    r2 = x * x + y * y
    radial = np.polynomial.polynomial.polyval(r2, k)
    dx = x * radial + p1 * (r2 + 2 * x * x) + 2 * p2 * x * y
    dy = y * radial + p2 * (r2 + 2 * y * y) + 2 * p1 * x * y
    return point + np.array([dx, dy])


def sheared(point):
    x, y = point - PPA_MM
    along_x = COEFFICIENTS["b1"] * x + COEFFICIENTS["b2"] * y
    return point + np.array([along_x, 0.0])


def ideal_of(measured, sense):
    if sense == "correction":
        return moved(sheared(measured))
    ideal = measured
    for _ in range(60):  # contracts by 0.01 a time
        ideal = ideal + measured - sheared(moved(ideal))
    return ideal


# Right and down in the image.
DIRECTIONS = {
    "right": (1.0, 0.0),
    "left": (-1.0, 0.0),
    "up": (0.0, -1.0),
    "down": (0.0, 1.0),
}


@pytest.mark.parametrize(
    "axes",
    [
        "right up",
        "right down",
        "left up",
        "left down",
        "up right",
        "up left",
        "down right",
        "down left",
    ],
)
@pytest.mark.parametrize("sense", ["correction", "distortion"])
def test_every_axis_and_sense_against_the_formulas(axes, sense):
    focal = 100.5
    pixel = np.array([0.006, 0.0062])
    origin = np.array([6700.0, 4100.0])
    size = (13400, 8200)
    camera = metric_camera(
        focal,
        size=size,
        pixel_mm=pixel,
        format_mm=size * pixel,
        origin_px=origin,
        axes=axes,
        ppa_mm=tuple(PPA_MM),
        ppbs_mm=tuple(PPBS_MM),
        coefficients=COEFFICIENTS,
        sense=sense,
    )
    x_and_y = [DIRECTIONS[word] for word in axes.split()]
    to_image = np.transpose(x_and_y)  # of the report's x and y
    pixels = np.array(
        [
            [200.0, 300.0],
            [13000.0, 7900.0],
            [6900.0, 800.0],
        ]
    )
    expected = []
    for point in pixels:
        measured = to_image.T @ ((point - origin) * pixel)
        expected.append(to_image @ (ideal_of(measured, sense) - PPA_MM) / focal)
    u, v, covered = camera.rays(*pixels.T.copy())
    assert covered.all()
    assert_near(np.stack([u, v], axis=1), expected, 1e-13)
    assert_near(camera.project(u, v), pixels.T, 1e-9)


def test_a_table_alone_is_fitted_and_ends_where_it_ends():
    focal, coefficients, _ = OSL_3030
    k0, k1, k2, _, _ = coefficients.values()
    r = focal * np.tan(np.radians(ANGLES))
    # The distortion of the printed coefficients, not rounded to micrometres.
    dr = -(r * k0 + k1 * r**3 + k2 * r**5)
    table = np.stack([r, dr], axis=1)
    fitted = metric_camera(
        focal,
        **SCAN,
        coefficients={},
        table=(table, "distortion"),
    )
    exact = metric_camera(
        focal,
        **SCAN,
        sense="correction",
        coefficients={"k0": k0, "k1": k1, "k2": k2},
    )
    # 128.6 mm are 6430 px; the fourth pixel is 6336 px from the origin, the last one farther.
    x = np.array([5760.0, 9000.0, 9800.0, 10_240.0, 11400.0])
    y = np.array([5745.0, 3000.0, 9500.0, 10_225.0, 11400.0])

    u, v, covered = fitted.rays(x, y)

    assert covered.tolist() == [True] * 4 + [False]
    assert np.isnan(u[4])
    u_exact, v_exact, _ = exact.rays(x, y)
    limit = 0.02 * 1e-3 / focal  # 0.02 um
    assert_near(u[:3], u_exact[:3], limit)
    assert_near(v[:3], v_exact[:3], limit)


RADII_MM = np.arange(20.0, 141.0, 20.0)
ZIGZAG_MM = np.array([0.0, 0.004, -0.004, 0.005, -0.005, 0.004, -0.004])
ZIGZAG = (np.stack([RADII_MM, ZIGZAG_MM], axis=1), "distortion")


@pytest.mark.parametrize(
    ("changes", "code", "number"),
    [
        ({"pixel_mm": (0.014, 0.014)}, "CAMERA-FORMAT", "0.700"),
        ({"pixel_mm": (0.02, 0.028)}, "CAMERA-FORMAT", "1.400"),
        ({"format_mm": (230.0, 150.0)}, "CAMERA-FORMAT", "1.533"),
        ({"ppa_mm": (115.0, 114.8)}, "CAMERA-PRINCIPAL-POINT", "50 %"),
        ({"origin_px": (0.0, 11500.0)}, "CAMERA-PRINCIPAL-POINT", "50 %"),
        ({"table": ZIGZAG}, "CAMERA-REPORT", "a polynomial differ by"),
    ],
)
def test_what_cannot_be_is_refused_with_the_number(changes, code, number):
    fields = SCAN | {"coefficients": {}} | changes
    with refused(code, PhysicsError) as refusal:
        metric_camera(153.0, **fields)
    assert refusal.match(number)
