"""How tables are written, by their first lines."""

import pytest

from unbend.table_dialect import BLANKS, form_of


@pytest.mark.parametrize(
    ("text", "separator", "names"),
    [
        ("a 1,5 2,5\nb 3,5 4,5", BLANKS, "1 2 3"),
        ("image, x, y\na, 1, 2", ",", "image x y"),
        ("image;note;x\na;b, c;1,5", ";", "image note x"),
        ("# made by hand\n#image x\na 1\nb 2", BLANKS, "image x"),
        ("\n  \nimage\tx\na\t1", "\t", "image x"),
        ("EPSG:32632\na.jpg 1 2 3\nb.jpg 1 2 3", BLANKS, "image x y z"),
        ("+proj=utm +zone=32\na.jpg 1 2\nb.jpg 1 2", BLANKS, "image x y"),
        ("image,camera\na,b", ",", "image camera"),
        ("image,x", ",", "image x"),
        ("# image, x", ",", "image x"),
        ("one column", BLANKS, "one column"),
        ("image", ",", "image"),
    ],
)
def test_separators_and_names(text, separator, names):
    form = form_of(text.splitlines())
    assert form.separator == separator
    assert form.names == tuple(names.split())


def test_where_rows_begin():
    form = form_of(["# Cameras (2)", "", "# image, x", "a\t1", "b\t2"])
    assert form.lines_before == 3
    assert not form.head_is_row
    assert form.line_of_first_row == 4


def test_a_line_that_states_the_separator_is_no_head():
    assert form_of(["sep=;", "image;x", "a;1"]).line_of_first_row == 3


@pytest.mark.parametrize("lines", [[], ["", " "], ["a,b", "1,2,3"]])
def test_what_shows_no_form(lines):
    with pytest.raises(ValueError, match=r"empty|its first row has 2 fields"):
        form_of(lines)


def test_a_field_of_many_pages_is_no_table():
    with pytest.raises(ValueError, match="field larger than"):
        form_of(["a,b", '1,"' + 140_000 * "x"])


@pytest.mark.parametrize(
    "lines",
    [
        ["image;x", "a;8.927,4661", "b;514,2"],
        ["image,x", 'a,"8,927.4661"', "b,514.2"],
        ["image\tx", "a\t8'927.5", "b\t1"],
        ["image;x", "a;8\u00a0927", "b;1"],
    ],
)
def test_thousands_are_refused_in_words(lines):
    with pytest.raises(ValueError, match="groups its thousands"):
        form_of(lines)


def test_a_name_among_which_one_looks_like_thousands_is_a_name():
    assert form_of(["image;x", "8'927;1", "b;2"]).names == ("image", "x")
