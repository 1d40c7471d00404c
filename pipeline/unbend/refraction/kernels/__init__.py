"""The compiled parts of the ray, the image and the standard deviations."""
