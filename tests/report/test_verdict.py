"""What a run means and what to do next, from the manifests of runs that went well or wrong."""

from __future__ import annotations

import copy
import json
import re

import numpy as np
import pyarrow as pa
import pytest

from unbend.report.summary import next_steps, outcome, remarks

from .manifests import manifest_of

READY = "). Ready for bundle adjustment"
LOOK = "). Check "


def values_of(mission) -> dict:
    """The manifest of a run as plain values."""
    return json.loads((mission.output / "manifest.json").read_text(encoding="utf-8"))


def ran(mission, code: int) -> tuple[dict, str, str]:
    """Its manifest, verdict and next steps, which the terminal prints too."""
    ended = mission.run()
    assert ended.code == code, ended.text
    manifest = values_of(mission)
    steps = " ".join(next_steps(manifest_of(manifest)))
    text = outcome(manifest_of(manifest))
    printed = " ".join(ended.out.split())
    assert text in printed
    assert steps in printed
    return manifest, text, steps


def with_heights(mission, heights) -> None:
    table = mission.measurements()
    h_g = np.array(table["h_g_m"].to_numpy(), dtype=float)
    column = table.schema.get_field_index("h_g_m")
    mission.observe(table.set_column(column, "h_g_m", pa.array(heights(h_g), from_pandas=True)))


def test_all_corrected(baseline):
    """Size by the results themselves, in the median and for 95 % of them."""
    manifest = values_of(baseline)
    rows = baseline.results().to_pandas()
    moved = np.hypot(rows["x_corrected_px"] - rows["x_px"], rows["y_corrected_px"] - rows["y_px"])
    text = outcome(manifest_of(manifest))
    assert text.startswith("All 59 observations were corrected by ")
    words = re.search(
        r"by (\S+) cm on the ground, (\S+) px in the image \(median; 95 %: "
        r"(\S+) cm, (\S+) px\)",
        text,
    )
    ground = manifest["correction"]["shift_ground_m"]
    sizes = [float(word) for word in words.groups()]
    assert sizes[1] == pytest.approx(np.median(moved), rel=0.1)
    assert sizes[3] == pytest.approx(np.percentile(moved, 95.0), rel=0.1)
    assert sizes[0] / 100.0 == pytest.approx(ground["median"], rel=0.05)
    assert sizes[2] / 100.0 == pytest.approx(ground["p95"], rel=0.05)
    assert text.endswith(f"{READY}.")
    steps = next_steps(manifest_of(manifest))
    assert steps[-1] == (
        "Switch off the refraction correction of the adjustment program: never correct twice."
    )
    assert not any("suspect" in step or "Leave out" in step for step in steps)


def test_some_flagged_and_none_corrected(mission, plain_report):
    def no_first_two(h):
        h[:2] = np.nan
        return h

    with_heights(mission, no_first_two)
    _, text, steps = ran(mission, 3)
    assert text.startswith("57 of 59 observations were corrected by ")
    assert text.endswith(f"{READY} without the other 2 rows.")
    assert steps.startswith("Leave out 2 rows without new coordinates (2 no_ground);")
    with_heights(mission, lambda h: h + np.nan)
    _, text, steps = ran(mission, 3)
    assert text.startswith("None of 59 observations could be corrected: 59 no_ground")
    assert "djust" not in steps
    assert "correct the mission file, run again" in steps


def test_a_likely_mistake_is_not_ready(mission, plain_report):
    """Heights in feet: every observation gets a correction, and none may be used."""
    with_heights(mission, lambda h: h * 3.28084)
    manifest, text, steps = ran(mission, 3)
    assert manifest["observations"]["status"]["ok"] == 59
    found = [e["code"] for e in manifest["ledger"] if e["kind"] == "finding"]
    assert "PLAUSIBLE-GROUND" in found
    assert READY not in text
    assert text.endswith(f"{LOOK}1 likely mistake (PLAUSIBLE-GROUND) before use.")
    assert steps.startswith("Correct the cause of PLAUSIBLE-GROUND")


def test_air_that_was_not_measured(mission, baseline, plain_report):
    """By a standard without a standard deviation, and by a climatology with one."""
    mission.config["atmosphere"] = {"adjust": False}
    for camera in mission.config["cameras"].values():
        camera.pop("window", None)
    for role in ("pressure", "temperature", "humidity"):
        mission.config["log"]["channels"].pop(f"cabin_{role}")
    manifest, text, steps = ran(mission, 0)
    (remark,) = remarks(manifest_of(manifest))
    assert remark == "The air was not measured: a standard atmosphere is used instead."
    assert text.endswith(f"{READY}.")
    assert "For a better correction, remove atmosphere.adjust: false" in steps
    assert "thermometer" not in steps
    manifest = copy.deepcopy(values_of(baseline))
    manifest["profile"]["basis"] = "climatology"
    manifest["uncertainty"]["scale_sigma"] = 0.0412
    steps = " ".join(next_steps(manifest_of(manifest)))
    assert "For a better correction, give a thermometer" in steps
    assert (
        "a climatology is used instead, the refraction R is known to ± 4.1 %."
        in remarks(manifest_of(manifest))[0]
    )


def test_a_correction_too_small_to_matter(baseline):
    """One of 1.1 px, made 30 times smaller; not said where many rows could not be corrected."""
    manifest = copy.deepcopy(values_of(baseline))
    for of in (manifest["correction"]["shift_px"], manifest["correction"]["shift_ground_m"]):
        of["maximum"] /= 30.0
    assert outcome(manifest_of(manifest)).endswith("), too small to measure: not needed here.")
    assert any("difference is not measurable" in step for step in next_steps(manifest_of(manifest)))
    manifest["correction"]["shift_px"]["count"] = 40
    assert "not needed" not in outcome(manifest_of(manifest))


@pytest.mark.parametrize(
    ("cabin", "air", "end"),
    [
        (0.05, 0.012, "5 % of the refraction R, the air outside of 1.2 % only."),
        (0.021, 0.13, "2.1 % of the refraction R, the air outside of 13 %."),
        (0.03, None, "3 % of the refraction R."),
        (0.02, 0.01, None),
        (None, 0.01, None),
    ],
)
def test_the_cabin_is_in_it_from_two_percent_on(baseline, cabin, air, end):
    manifest = copy.deepcopy(values_of(baseline))
    manifest["cabin_sigma_share"]["median"] = cabin
    manifest["uncertainty"] = None if air is None else {"scale_sigma": air}
    assert "cabin" not in outcome(manifest_of(manifest))
    if end is None:
        assert remarks(manifest_of(manifest)) == []
    else:
        text = f"The air in the cabin causes a median uncertainty of {end}"
        assert remarks(manifest_of(manifest)) == [text]
        assert (
            "The sigma of the sensors in the cabin is assumed to be 3 hPa, 1 K. If it is "
            "smaller, give sigma_pressure_hpa, sigma_temperature_k (cameras.nadir.window.cabin, "
            "cameras.oblique.window.cabin)."
        ) in next_steps(manifest_of(manifest))


def test_the_cabin_is_to_be_measured_only_where_it_was_not(baseline):
    manifest = copy.deepcopy(values_of(baseline))
    manifest["cabin_sigma_share"]["median"] = 0.05

    def step() -> str:
        (found,) = [step for step in next_steps(manifest_of(manifest)) if "window.cabin" in step]
        return found

    windows = {name: c["window"] for name, c in manifest["config"]["cameras"].items()}
    windows["nadir"]["cabin"] = "standard_schedule"
    asked = "Measure the air in the cabin, or state it: cameras.nadir.window.cabin."
    assert step() == asked
    windows["nadir"]["cabin"] = stated = {
        "pressure": "log",
        "pressure_hpa": None,
        "temperature_c": None,
        "relative_humidity": None,
        "sigma_pressure_hpa": 1.0,
        "sigma_temperature_k": None,
    }
    windows["oblique"]["shape"] = "spherical"
    assert step().startswith("The sigma of the sensors in the cabin is assumed to be 1 K. ")
    assert step().endswith("give sigma_temperature_k (cameras.nadir.window.cabin).")
    stated["sigma_temperature_k"] = 0.5
    assert "more accurately than stated" in step()
    missing = {"kind": "fallback", "code": "CABIN-TEMPERATURE", "what": "", "where": "camera nadir"}
    manifest["ledger"].append(missing)
    assert step() == asked


@pytest.mark.parametrize("kind", ["loss", "finding"])
def test_nothing_that_ended_with_three_is_ready(baseline, kind):
    """Of the losses only those of single rows, which have no coordinates, leave the rest ready."""
    manifest = copy.deepcopy(values_of(baseline))
    manifest["ledger"] += [{"kind": kind, "code": "LOG-BAD-BYTES", "what": "77 bytes"}] * 2
    text = outcome(manifest_of(manifest))
    assert READY not in text
    noun = {"loss": "1 loss", "finding": "1 likely mistake"}[kind]
    assert text.endswith(f"{LOOK}{noun} (LOG-BAD-BYTES) before use.")


def test_an_incomplete_log_is_no_mistake(baseline):
    """Messages that the link lost: another concern than a mistake, and one that can be accepted."""
    manifest = copy.deepcopy(values_of(baseline))
    lost = {"kind": "finding", "code": "LOG-LINK-LOSS", "what": "the log is incomplete: 9 messages"}
    manifest["ledger"] += [lost, {**lost, "code": "LOG-GAP"}]
    text = outcome(manifest_of(manifest))
    assert text.endswith(f"{LOOK}an incomplete log (LOG-GAP, LOG-LINK-LOSS) before use.")
    assert "mistake" not in text
    assert any("accept LOG-GAP, LOG-LINK-LOSS" in s for s in next_steps(manifest_of(manifest)))


def test_a_published_method_is_not_for_work(baseline):
    manifest = copy.deepcopy(values_of(baseline))
    manifest["config"]["refraction"]["method"] = "gyer1996"
    assert outcome(manifest_of(manifest)).endswith(
        "the method gyer1996 (published, for comparison) before use."
    )
