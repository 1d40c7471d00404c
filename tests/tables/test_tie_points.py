"""Points that several images show, drawn from tables of observations."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest
from numpy.testing import assert_array_equal

from tests.tables.observed import opened
from unbend.tables.pixels import PixelSystem
from unbend.tables.tie_points import draw_tie_points


def strip(images: int, points: int) -> pa.Table:
    """A strip of images, each point in three that follow each other."""
    point = np.repeat(np.arange(points), 3)
    image = point % (images - 2) + np.tile([0, 1, 2], points)
    columns = {
        "image": [f"i{number:03d}" for number in image.tolist()],
        "point": [f"p{number}" for number in point.tolist()],
        "x_px": 10.0 + image,
        "y_px": 20.0 + point,
    }
    return pa.table(columns)


def test_points_of_one_image_and_unusable_rows_are_left_out(tmp_path):
    text = (
        "image,point,x_px,y_px\n"
        "a,1,10,20\nb,1,11,21\n"  # a tie point
        "a,2,10,20\na,2,10,20\n"  # twice in one image
        "a,3,10,20\nb,3,,21\n"  # no number
        "c,4,10,20\n,4,10,20\n"  # no image
        "b,5,1,2\nc,5,3,4\n"
    )
    ties = draw_tie_points(opened(tmp_path, text), most=50)
    images = [ties.images[number] for number in ties.image]
    drawn = set(zip(images, ties.x_px, ties.y_px, strict=True))
    assert drawn == {("a", 10, 20), ("b", 11, 21), ("b", 1, 2), ("c", 3, 4)}
    assert np.bincount(ties.point).tolist() == [2, 2]
    assert ties.repeated == ("2 in a",)


def test_every_image_has_some_of_the_few_that_are_drawn(tmp_path):
    table = strip(60, 3000)
    ties = draw_tie_points(opened(tmp_path, table), most=80)
    assert np.unique(ties.point).size == 80
    assert (np.bincount(ties.point) == 3).all()
    assert np.bincount(ties.image, minlength=60).min() >= 1
    order = np.random.default_rng(1).permutation(table.num_rows)
    again = draw_tie_points(opened(tmp_path, table.take(order)), most=80)
    assert_array_equal(ties.y_px, again.y_px)
    assert_array_equal(ties.image, again.image)


def test_rays_of_one_point_are_limited(tmp_path):
    images = [f"i{number}" for number in range(50)]
    numbers = np.ones(100)
    points = ["a"] * 50 + ["b"] * 50
    table = pa.table({"image": images * 2, "point": points, "x_px": numbers, "y_px": numbers})
    ties = draw_tie_points(opened(tmp_path, table), most=50)
    assert np.bincount(ties.point).tolist() == [4, 4]
    assert np.unique(ties.image[ties.point == 0]).size == 4


def test_a_table_without_tie_points(tmp_path):
    table = strip(5, 4)[::3]
    assert draw_tie_points(opened(tmp_path, table), most=50).image.size == 0


def test_a_large_table_is_thinned_by_points_and_not_by_rows(tmp_path):
    """Of 600,000 rows those of a third of the points."""
    ties = draw_tie_points(opened(tmp_path, strip(60, 200_000)), most=200_000)
    rays = np.bincount(ties.point)
    assert (rays == 3).all()
    assert rays.size == pytest.approx(66_667, rel=0.01)


@pytest.mark.parametrize(("origin", "first"), [("corner", 10.0), ("centre", 10.5)])
def test_pixels_are_colmaps(tmp_path, origin, first):
    observations = opened(tmp_path, strip(5, 9), pixels=PixelSystem(origin))
    assert draw_tie_points(observations, most=50).x_px.min() == first
