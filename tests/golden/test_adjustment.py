"""The adjustment of docs/pages/guide/pycolmap.md, with the sample flight: what it is all for."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from pipeline.batch.plan import Outcome

from .conftest import REPOSITORY

PAGE = REPOSITORY / "docs" / "pages" / "guide" / "pycolmap.md"
(RECIPE,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S)


@pytest.fixture
def beside_results(
    runs: dict[str, Outcome], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Path:
    """A folder as it looks after `make sample`."""
    shutil.copytree(runs["bin"].output, tmp_path / "results" / "sample_bin")
    (tmp_path / "sample_logs").mkdir()
    shutil.copy(REPOSITORY / "sample_logs" / "observations.parquet", tmp_path / "sample_logs")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def execute(code: str) -> dict[str, Any]:
    names: dict[str, Any] = {}
    exec(compile(code, PAGE.name, "exec"), names)
    return names


def height_error(code: str, truth: dict[str, pd.DataFrame]) -> float:
    """RMS error in height [m] of the points that the page's adjustment finds."""
    found = execute(code)
    true = truth["points"].set_index("point").loc[list(found["points"])]
    ecef = np.stack(
        found["ecef"].transform(true["lon_deg"], true["lat_deg"], true["h_ellipsoid_m"]), axis=1
    )
    expected = found["enu"](found["lat0"], found["lon0"]).apply(ecef - found["origin"])
    error = np.array(list(found["points"].values())) - expected
    assert len(error) > 500
    return float(np.sqrt(np.mean(error[:, 2] ** 2)))


def test_the_page_shows_what_the_correction_is_worth(
    beside_results: Path, truth: dict[str, pd.DataFrame], capsys: pytest.CaptureFixture[str]
) -> None:
    """Stations as the log has them; measured 0.027 and 0.136 m."""
    code = RECIPE.replace("flown/results/simulated_bin", "results/sample_bin")
    code = code.replace("flown/observations.parquet", "sample_logs/observations.parquet")
    corrected = '"x_corrected_px", "y_corrected_px"'
    assert code.count(corrected) == 1
    uncorrected = code.replace(corrected, '"x_px", "y_px"')
    # The shift with the wrong sign: as far off on the other side.
    turn = "".join(
        f"\nobservations[{a}] = 2 * observations.{a}_px - observations[{a}]" for a in "xy"
    )
    turned = code.replace("\n\n\ndef enu", f"{turn}\n\n\ndef enu")
    assert turned != code
    errors = {
        name: height_error(text, truth)
        for name, text in (("with", code), ("without", uncorrected), ("turned", turned))
    }
    with capsys.disabled():
        print("\nheight rms [m] " + ", ".join(f"{k} {v:.4f}" for k, v in errors.items()))
    assert errors["with"] <= 0.03
    assert errors["without"] >= 0.13
    assert errors["turned"] > 1.5 * errors["without"]
