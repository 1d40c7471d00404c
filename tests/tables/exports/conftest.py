"""Blocks for exports; two that differ in what some formats do not hold."""

import pytest

from tests.tables.exports.projected_block import SQUARE, Block


@pytest.fixture(scope="module")
def block(tmp_path_factory):
    return Block(tmp_path_factory.mktemp("block"))


@pytest.fixture(scope="module")
def square(tmp_path_factory):
    """The same with one principal distance in its first camera."""
    return Block(tmp_path_factory.mktemp("square"), nadir=SQUARE)
