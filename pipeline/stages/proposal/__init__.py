"""A mission file proposed from a log and observations, for `unbend init`."""
