"""Heights of the ground under the observed points: one module a kind of source."""
