"""Where things are on the earth: coordinate systems, the geoid, points and their heights."""
