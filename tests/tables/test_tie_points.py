"""Points that several images show, drawn from tables of observations."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from unbend.messages import Ledger
from unbend.tables import tie_points
from unbend.tables.observations import Observations, open_observations
from unbend.tables.pixels import PixelSystem
from unbend.tables.tie_points import draw_tie_points

COLUMNS = {name: name for name in ("image", "point", "x_px", "y_px")}


def opened(path: Path, table: pd.DataFrame, **options) -> Observations:
    table.to_csv(path, index=False)
    return open_observations(path, COLUMNS, None, Ledger(), **options)


def strip(images: int, points: int) -> pd.DataFrame:
    """A strip of images, each point in three that follow each other."""
    rows = [
        (f"i{image:03d}", f"p{point}", 10.0 + image, 20.0 + point)
        for point in range(points)
        for image in range(point % (images - 2), point % (images - 2) + 3)
    ]
    return pd.DataFrame(rows, columns=["image", "point", "x_px", "y_px"])


def test_points_of_one_image_and_unusable_rows_are_left_out(tmp_path):
    text = (
        "image,point,x_px,y_px\n"
        "a,1,10,20\nb,1,11,21\n"  # a tie point
        "a,2,10,20\na,2,10,20\n"  # twice in one image
        "a,3,10,20\nb,3,,21\n"  # no number
        "c,4,10,20\n,4,10,20\n"  # no image
        "b,5,1,2\nc,5,3,4\n"
    )
    path = tmp_path / "o.csv"
    path.write_text(text)
    ties = draw_tie_points(open_observations(path, COLUMNS, None, Ledger()), most=50)
    found = {
        (ties.images[i], x, y) for i, x, y in zip(ties.image, ties.x_px, ties.y_px, strict=True)
    }
    assert found == {("a", 10, 20), ("b", 11, 21), ("b", 1, 2), ("c", 3, 4)}
    assert sorted(np.bincount(ties.point)) == [2, 2]
    assert ties.repeated == ("2 in a",)


def test_every_image_has_some_of_the_few_that_are_drawn(tmp_path):
    table = strip(60, 3000)
    ties = draw_tie_points(opened(tmp_path / "o.csv", table), most=80)
    assert np.unique(ties.point).size == 80
    assert (np.bincount(ties.point) == 3).all()
    assert np.bincount(ties.image, minlength=60).min() >= 1
    shuffled = opened(tmp_path / "s.csv", table.sample(frac=1.0, random_state=1))
    again = draw_tie_points(shuffled, most=80)
    np.testing.assert_array_equal(ties.y_px, again.y_px)
    np.testing.assert_array_equal(ties.image, again.image)


def test_rays_of_one_point_are_limited(tmp_path):
    table = pd.DataFrame(
        {
            "image": [f"i{n}" for n in range(50)] * 2,
            "point": ["a"] * 50 + ["b"] * 50,
            "x_px": 1.0,
            "y_px": 2.0,
        }
    )
    ties = draw_tie_points(opened(tmp_path / "o.csv", table), most=50)
    assert np.bincount(ties.point).tolist() == [4, 4]
    assert np.unique(ties.image[ties.point == 0]).size == 4


def test_a_table_without_tie_points(tmp_path):
    table = strip(5, 4).drop_duplicates("point")
    assert draw_tie_points(opened(tmp_path / "o.csv", table), most=50).image.size == 0


def test_a_large_table_is_thinned_by_points_and_not_by_rows(tmp_path, monkeypatch):
    monkeypatch.setattr(tie_points, "_ROWS_KEPT", 1000)
    ties = draw_tie_points(opened(tmp_path / "o.csv", strip(60, 3000)), most=3000)
    assert (np.bincount(ties.point) == 3).all()
    assert 200 < np.unique(ties.point).size < 500


@pytest.mark.parametrize(("origin", "first"), [("corner", 10.0), ("centre", 10.5)])
def test_pixels_are_colmaps(tmp_path, origin, first):
    ties = draw_tie_points(
        opened(tmp_path / "o.csv", strip(5, 9), pixels=PixelSystem(origin)), most=50
    )
    assert ties.x_px.min() == first
