"""The manifest of a run: the records of its contents, for the code that writes and reads it."""
