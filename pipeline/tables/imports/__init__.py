"""Stations, trajectories and camera events from the files of other programs."""
