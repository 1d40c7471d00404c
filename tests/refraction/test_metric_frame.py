"""Reports in millimetres: published ones, an independent chain of formulas, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

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


def metric_camera(size, focal_mm, **given):
    return camera_of_report(MetricReport(focal_mm, **given), size)


def table_of(report):
    focal, _, radial = report
    return np.stack([focal * np.tan(np.radians(ANGLES)), np.array(radial) * 1e-3], axis=1)


def by_hand(x_mm, y_mm, report, ppa, ppbs):
    """Ideal image coordinates of measured ones, as the report prescribes: SMAC's formulas."""
    focal, k, _ = report
    x = x_mm - ppbs[0]
    y = y_mm - ppbs[1]
    r2 = x**2 + y**2
    radial = k["k0"] + k["k1"] * r2 + k["k2"] * r2**2
    x_c = x_mm + x * radial + k["p1"] * (r2 + 2.0 * x**2) + 2.0 * k["p2"] * x * y
    y_c = y_mm + y * radial + k["p2"] * (r2 + 2.0 * y**2) + 2.0 * k["p1"] * x * y
    return (x_c - ppa[0]) / focal, (y_c - ppa[1]) / focal


@pytest.mark.parametrize("report", [OSL_2985, OSL_3030])
def test_a_published_report(report):
    """Coefficients that correct and a table of the distortion agree; the same sense does not."""
    focal, coefficients, _ = report
    given = SCAN | {"coefficients": coefficients, "sense": "correction"}
    camera = metric_camera(SIZE, focal, **given, table=(table_of(report), "distortion"))
    x_mm, y_mm = (a.ravel() for a in np.meshgrid(*[np.linspace(-80.0, 80.0, 17)] * 2))
    u, v, covered = camera.rays(5760.0 + x_mm / 0.02, 5745.0 - y_mm / 0.02)
    assert covered.all()
    wanted = by_hand(x_mm, y_mm, report, SCAN["ppa_mm"], SCAN["ppbs_mm"])
    np.testing.assert_allclose((u, -v), wanted, rtol=0.0, atol=1e-9 / camera.fx_px)
    again = camera.project(u, v)
    np.testing.assert_allclose(
        again, (5760.0 + x_mm / 0.02, 5745.0 - y_mm / 0.02), rtol=0.0, atol=1e-9
    )
    with pytest.raises(PhysicsError, match=r"coefficients differ by 2\.\d um at a radius") as no:
        metric_camera(SIZE, focal, **given, table=(table_of(report), "correction"))
    assert no.value.code == "CAMERA-REPORT"


def test_one_point_by_hand():
    """OSL/2985 at x = 100 mm: dr = 2.616 - 2.295 + 0.145 um, decentring 3 p1 x^2, p2 x^2."""
    focal, coefficients, _ = OSL_2985
    given = SCAN | {"ppa_mm": (0.0, 0.0), "ppbs_mm": (0.0, 0.0), "coefficients": coefficients}
    camera = metric_camera(SIZE, focal, **given, sense="correction")
    u, v, _ = camera.rays(np.array([5760.0 + 5000.0]), np.array([5745.0]))
    dx_um = 2.616 - 2.295 + 0.1454 - 3.0 * 0.3015
    assert focal * u[0] * 1e3 - 100e3 == pytest.approx(dx_um, abs=1e-6)
    assert -focal * v[0] * 1e3 == pytest.approx(0.1668, abs=1e-6)
    # As a distortion the same numbers move an ideal point there by the same to the other side.
    other = metric_camera(SIZE, focal, **given, sense="distortion")
    x, _ = other.project(np.array([100.0 / focal]), np.array([0.0]))
    assert (x[0] - 5760.0) * 20.0 - 100e3 == pytest.approx(dx_um, abs=1e-6)


@pytest.mark.parametrize(
    ("axes", "right", "down"),
    [
        ("right up", (1, 0), (0, -1)), ("right down", (1, 0), (0, 1)),
        ("left up", (-1, 0), (0, -1)), ("left down", (-1, 0), (0, 1)),
        ("up right", (0, 1), (-1, 0)), ("up left", (0, -1), (-1, 0)),
        ("down right", (0, 1), (1, 0)), ("down left", (0, -1), (1, 0)),
    ],
)  # fmt: skip
@pytest.mark.parametrize("sense", ["correction", "distortion"])
def test_every_axis_and_sense_against_the_formulas(axes, right, down, sense):
    focal = 100.5
    ppa = (0.21, -0.13)
    ppbs = (0.05, 0.08)
    k = {
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
    pixel = np.array([0.006, 0.0062])
    origin = np.array([6700.0, 4100.0])
    size = (13400, 8200)
    camera = metric_camera(
        size,
        focal,
        pixel_mm=pixel,
        format_mm=size * pixel,
        origin_px=origin,
        axes=axes,
        ppa_mm=ppa,
        ppbs_mm=ppbs,
        coefficients=k,
        sense=sense,
    )
    from_own = np.array([right, down], float)  # rows: right and down, along the report's x and y

    def function(point):  # about the principal point of symmetry
        x, y = np.subtract(point, ppbs)
        r2 = x * x + y * y
        radial = sum(k[f"k{i}"] * r2**i for i in range(5))
        dx = x * radial + k["p1"] * (r2 + 2 * x * x) + 2 * k["p2"] * x * y
        dy = y * radial + k["p2"] * (r2 + 2 * y * y) + 2 * k["p1"] * x * y
        return np.array([point[0] + dx, point[1] + dy])

    def affine(point):
        x, y = np.subtract(point, ppa)
        return np.array([x + k["b1"] * x + k["b2"] * y, y]) + ppa

    for x_px, y_px in ((200.0, 300.0), (13000.0, 7900.0), (6900.0, 800.0)):
        measured = from_own.T @ ((np.array([x_px, y_px]) - origin) * pixel)
        if sense == "correction":
            ideal = function(affine(measured))
        else:
            ideal = measured
            for _ in range(60):  # contracts by 0.01 a time
                ideal = ideal + measured - affine(function(ideal))
        wanted = from_own @ (ideal - ppa) / focal
        u, v, covered = camera.rays(np.array([x_px]), np.array([y_px]))
        assert covered.all()
        np.testing.assert_allclose((u[0], v[0]), wanted, rtol=0.0, atol=1e-13)
        np.testing.assert_allclose(camera.project(u, v), [[x_px], [y_px]], rtol=0.0, atol=1e-9)


def test_a_table_alone_is_fitted_and_ends_where_it_ends():
    focal, coefficients, _ = OSL_3030
    r = focal * np.tan(np.radians(ANGLES))
    # The distortion of the printed coefficients, not rounded to micrometres.
    dr = -(r * coefficients["k0"] + coefficients["k1"] * r**3 + coefficients["k2"] * r**5)
    table = np.stack([r, dr], axis=1)
    fitted = metric_camera(SIZE, focal, **SCAN, coefficients={}, table=(table, "distortion"))
    known = metric_camera(
        SIZE,
        focal,
        **SCAN,
        sense="correction",
        coefficients={n: v for n, v in coefficients.items() if n[0] == "k"},
    )
    x = np.array([5760.0, 9000.0, 9800.0])
    y = np.array([5745.0, 3000.0, 9500.0])
    got = fitted.rays(x, y)
    wanted = known.rays(x, y)
    np.testing.assert_allclose(got[:2], wanted[:2], rtol=0.0, atol=0.02 * 1e-3 / focal)  # 0.02 um
    assert got[2].all()
    # 128.6 mm are 6430 px; the corner of the scan is farther.
    u, _, covered = fitted.rays(
        np.array([5760.0 + 6400.0 * 0.7, 11400.0]), np.array([5745.0 + 6400.0 * 0.7, 11400.0])
    )
    assert covered.tolist() == [True, False]
    assert np.isnan(u[1])


@pytest.mark.parametrize(
    ("changes", "code", "number"),
    [
        ({"pixel_mm": (0.014, 0.014)}, "CAMERA-FORMAT", "0.700"),
        ({"pixel_mm": (0.02, 0.028)}, "CAMERA-FORMAT", "1.400"),
        ({"format_mm": (230.0, 150.0)}, "CAMERA-FORMAT", "1.533"),
        ({"ppa_mm": (115.0, 114.8)}, "CAMERA-PRINCIPAL-POINT", "50 %"),
        ({"origin_px": (0.0, 11500.0)}, "CAMERA-PRINCIPAL-POINT", "50 %"),
        (
            {
                "table": (
                    np.array(
                        [
                            [20.0, 0.0],
                            [40.0, 0.004],
                            [60.0, -0.004],
                            [80.0, 0.005],
                            [100.0, -0.005],
                            [120.0, 0.004],
                            [140.0, -0.004],
                        ]
                    ),
                    "distortion",
                )
            },
            "CAMERA-REPORT",
            "a polynomial differ by",
        ),
    ],
)
def test_what_cannot_be_is_refused_with_the_number(changes, code, number):
    with pytest.raises(PhysicsError, match=number) as refused:
        metric_camera(SIZE, 153.0, **(SCAN | {"coefficients": {}} | changes))
    assert refused.value.code == code
