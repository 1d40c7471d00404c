"""Text tables that are read whole: angles of places, and comments between rows."""

from pathlib import Path

import pytest

from tests.helpers import refused
from unbend.tables.imports.messages import ORIENTATION_NUMBER
from unbend.tables.text_columns import degrees_of, whole_table

TABLE = Path("t.csv")


def latitudes(text):
    TABLE.write_text(text, "utf-8")
    table = whole_table(TABLE, ORIENTATION_NUMBER, ("image",))
    return degrees_of(table, "lat", TABLE, ORIENTATION_NUMBER, quantity="latitude")


@pytest.mark.parametrize("name", ["lat_ref", "LatRef", "N/S", "lat hemisphere"])
def test_a_column_of_hemispheres_gives_the_signs(name):
    text = f"image,lat,{name}\na,33.5,S\nb,33 30 0,South\nc,1.5,N\nd,1.5,\n"
    values = latitudes(text)
    assert values.tolist() == pytest.approx([-33.5, -33.5, 1.5, 1.5])


def test_another_column_gives_none():
    text = "image,lat,lon_ref,N/S\na,33.5,W,5\nb,34.5,W,6\n"
    values = latitudes(text)
    assert values.tolist() == [33.5, 34.5]


@pytest.mark.parametrize(
    "text",
    [
        "image,lat\na,8.5 E\n",
        "image,lat,lat_ref\na,-33.5,N\n",
    ],
)
def test_contradicting_hemispheres_are_refused(text):
    with refused("ORIENTATION-NUMBER"):
        latitudes(text)


def test_comments_between_rows_are_no_rows():
    TABLE.write_text("image,x\na,1\n# second strip\nb,2\n#c,3\n")

    table = whole_table(TABLE, ORIENTATION_NUMBER, ("image",))

    assert table["image"].tolist() == ["a", "b", "#c"]
    assert table.index.tolist() == [2, 4, 5]
