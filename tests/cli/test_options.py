"""Every option of a command has its effect: none is accepted and then ignored."""

from __future__ import annotations

import csv
import dataclasses
import importlib
import json
from types import SimpleNamespace

import numpy as np
import pytest

from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.series.profile_series import TimedProfile
from unbend.batch import runs
from unbend.refraction import METHODS


def rows_of(path) -> list[dict[str, str]]:
    return list(csv.DictReader(path.read_text(encoding="utf-8").splitlines()))


def test_run_with_force_runs_again(mission, plain_report):
    assert "nothing to do" not in mission.run().out
    assert "nothing to do" in mission.run().out
    assert "nothing to do" not in mission.run("--force").out


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ((), (7, 3000.0, 0.0)),
        (("--seed", 11), (11, 3000.0, 0.0)),
        (("--height", 1234.5), (7, 1234.5, 0.0)),
        (("--noise", 0.25), (7, 3000.0, 0.25)),
    ],
    ids=str,
)
def test_options_of_simulate(unbend, monkeypatch, tmp_path, options, expected):
    taken = []

    def simulate(out, settings, progress):
        taken.append((out, settings.seed, settings.height_above_ground_m, settings.image_noise_px))
        progress("rays", 1, 2)
        return SimpleNamespace(
            images=11,
            observation_count=2345,
            points=678,
            duration_s=90.0,
            missions={"bin": out / "bin.yaml"},
        )

    monkeypatch.setattr(importlib.import_module("unbend.simulate"), "simulate", simulate)
    ended = unbend("simulate", tmp_path / "flown", *options)
    assert ended.code == 0
    assert taken == [(tmp_path / "flown", *expected)]
    said = " ".join(ended.out.split())
    assert "11 images, 2,345 observations of 678 points, 90 s of flight in three logs" in said
    assert "unbend run" in said


def test_the_table_and_one_angle_agree_for_another_radius(unbend, tmp_path):
    """By two commands; at 45 degrees an earth of a tenth of the radius changes R by a percent."""
    out = tmp_path / "radial.csv"
    heights = ("--atmosphere", "icao", "--camera-height", 5000, "--ground-height", 100)
    found = {}
    for radius in (6_371_000, 637_100):
        ended = unbend("angle", *heights, "--radius", radius, "--step", 15, "--csv", out)
        assert ended.code == 0
        rows = {float(row["nadir_angle_deg"]): float(row["r_c_arcsec"]) for row in rows_of(out)}
        assert list(rows) == pytest.approx([0.0, 15.0, 30.0, 45.0, 60.0])
        angle = unbend("angle", *heights, "--radius", radius, "--nadir-angle", 45, "--json")
        found[radius] = json.loads(angle.out)["r_c_arcsec"]
        assert next(r for zeta, r in rows.items() if round(zeta) == 45) == pytest.approx(
            found[radius], rel=1e-9
        )
    assert abs(found[637_100] / found[6_371_000] - 1.0) > 2e-3


def test_profile_at_every_kilometre(unbend, tmp_path):
    out = tmp_path / "air.csv"
    assert unbend("profile", "--atmosphere", "us1976", "--step", 1000, "--csv", out).code == 0
    heights = np.array([float(row["h_m"]) for row in rows_of(out)])
    assert np.any(np.isclose(heights, 7000.0))
    assert np.allclose(np.diff(heights)[1:-1], 1000.0)


@pytest.mark.parametrize("step", [(), ("--step", 1000)], ids=str)
def test_a_profile_of_a_long_flight_has_all_its_parts(unbend, monkeypatch, tmp_path, step):
    air, samples, ledger = runs.air_of_mission_or_standard(None, "us1976")
    second = 1_000_000_000
    parts = tuple(
        TimedProfile(number * 3600 * second, standard_atmosphere(name))
        for number, name in enumerate(("us1976", "icao"))
    )
    series = dataclasses.replace(air.series, timed_profiles=parts)
    several = dataclasses.replace(air, series=series)
    monkeypatch.setattr(runs, "air_of_mission_or_standard", lambda *_: (several, samples, ledger))
    out = tmp_path / "air.csv"
    assert unbend("profile", "--atmosphere", "us1976", *step, "--csv", out).code == 0
    rows = rows_of(out)
    assert len({row["profile_id"] for row in rows}) == 2
    assert {row["time_utc"][:19] for row in rows} == {"1970-01-01 00:00:00", "1970-01-01 01:00:00"}


def test_the_help_of_angle_names_every_method(unbend):
    text = " ".join(unbend("angle", "--help").out.split())
    assert ", ".join(METHODS) in text
    assert "[default: spherical]" in text
