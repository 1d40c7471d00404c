"""Blocks for bundle adjustment: a module for each program's format, in its line of `BLOCKS`."""

from pipeline.tables.exports.blocks import (
    bingo,
    bundler,
    colmap_database,
    colmap_model,
    opensfm_project,
)

BLOCKS = (colmap_model, colmap_database, bundler, opensfm_project, bingo)
