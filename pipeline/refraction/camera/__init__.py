"""Cameras: pixels to rays and back. One module for each distortion model."""
