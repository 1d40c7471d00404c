"""Stages that compare several images of one point: assignment, orientations, heights."""
