"""Several images of one point: their rays intersected, and what that says of the stations."""
