"""Docstrings become Markdown for the API reference: lists of arguments, examples, links."""

import doctest

import pytest

pytest.importorskip("griffe")

from docs import docstrings


def test_the_example_of_its_docstring():
    assert doctest.testmod(docstrings) == (0, 1)


def test_arguments_examples_and_names():
    text = docstrings.as_markdown(
        "Correct rays.\n\n"
        "Parameters\n----------\n"
        "profile : a `Profile`.\n"
        "h_c, h_g : heights [m].\n"
        "sections : see ``ground``; a `nothing` stays.\n\n"
        ">>> 1 + 1\n2"
    )
    assert text.splitlines() == [
        "Correct rays.",
        "",
        "**Parameters**",
        "",
        "* **profile**: a [`Profile`][unbend.atmosphere.profile.Profile].",
        "* **h_c, h_g**: heights [m].",
        "* **sections**: see ``ground``; a `nothing` stays.",
        "",
        "```pycon",
        ">>> 1 + 1",
        "2",
        "```",
    ]
