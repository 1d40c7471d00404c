"""What `unbend init` proposes: a commented mission file, by a log, observations and images."""
