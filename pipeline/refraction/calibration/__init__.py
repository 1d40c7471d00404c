"""What calibrations say of a camera: models by name, reports in millimetres, and their checks."""
