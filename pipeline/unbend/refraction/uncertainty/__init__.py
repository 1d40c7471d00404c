"""Standard deviations of corrections: by the air, the station and the ground."""
