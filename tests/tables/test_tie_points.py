"""Points that several images show, drawn from tables of observations."""

import numpy as np
import pyarrow as pa
import pytest
from numpy.testing import assert_array_equal

from tests.tables.observed import opened
from unbend.tables.pixels import PixelSystem
from unbend.tables.tie_points import draw_tie_points

HEAD = "image,point,x_px,y_px\n"


def drawn(content, most=50, **options):
    observations = opened(content, **options)
    return draw_tie_points(observations, most)


def strip(images, points):
    """A strip of images, each point in three that follow each other."""
    point = np.repeat(np.arange(points), 3)
    first_image = point % (images - 2)
    image = first_image + np.tile([0, 1, 2], points)
    columns = {
        "image": np.char.mod("i%03d", image),
        "point": np.char.mod("p%d", point),
        "x_px": 10.0 + image,
        "y_px": 20.0 + point,
    }
    return pa.table(columns)


def test_points_of_one_image_and_unusable_rows_are_left_out():
    text = (
        "a,1,10,20\nb,1,11,21\n"  # a tie point
        "a,2,10,20\na,2,10,20\n"  # twice in one image
        "a,3,10,20\nb,3,,21\n"  # no number
        "c,4,10,20\n,4,10,20\n"  # no image
        "b,5,1,2\nc,5,3,4\n"
    )

    ties = drawn(HEAD + text)

    names = np.array(ties.images)[ties.image]
    rays = zip(names, ties.x_px, ties.y_px, strict=True)
    assert set(rays) == {
        ("a", 10, 20),
        ("b", 11, 21),
        ("b", 1, 2),
        ("c", 3, 4),
    }
    assert np.bincount(ties.point).tolist() == [2, 2]
    assert ties.repeated == ("2 in a",)


def test_every_image_has_some_of_the_few_that_are_drawn():
    table = strip(60, 3000)

    ties = drawn(table, most=80)

    rays_of_point = np.bincount(ties.point)
    assert rays_of_point.tolist() == [3] * 80
    assert np.bincount(ties.image, minlength=60).min() >= 1

    rng = np.random.default_rng(1)
    shuffled = table.take(rng.permutation(table.num_rows))
    of_shuffled_rows = drawn(shuffled, most=80)
    assert_array_equal(ties.y_px, of_shuffled_rows.y_px)
    assert_array_equal(ties.image, of_shuffled_rows.image)


def test_rays_of_one_point_are_limited():
    rows = []
    for point in "ab":
        for image in range(50):
            rows.append(f"i{image},{point},1,1\n")
    text = HEAD + "".join(rows)

    ties = drawn(text)

    assert np.bincount(ties.point).tolist() == [4, 4]
    images_of_a = ties.image[ties.point == 0]
    assert np.unique(images_of_a).size == 4


def test_a_table_without_tie_points():
    ray_of_each_point = strip(5, 4)[::3]
    assert drawn(ray_of_each_point).image.size == 0


def test_a_large_table_is_thinned_by_points_and_not_by_rows():
    """Of 600,000 rows those of a third of the points."""
    table = strip(60, 200_000)

    ties = drawn(table, most=200_000)

    rays_of_point = np.bincount(ties.point)
    assert (rays_of_point == 3).all()
    assert rays_of_point.size == pytest.approx(66_667, rel=0.01)


@pytest.mark.parametrize(
    ("origin", "first"),
    [
        ("corner", 10.0),
        ("centre", 10.5),
    ],
)
def test_pixels_are_colmaps(origin, first):
    ties = drawn(strip(5, 9), pixels=PixelSystem(origin))
    assert ties.x_px.min() == first
