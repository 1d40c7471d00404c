"""The air of a mission: its sources, and the profile adjusted to them."""
