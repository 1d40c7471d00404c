"""The air of a flight, estimated by least squares from everything that was measured."""
