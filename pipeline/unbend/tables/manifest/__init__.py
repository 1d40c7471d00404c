"""The manifest of a run: the records that its writers write and all its readers read."""
