"""Evidence in a log itself against the data of a flight.

- `autopilot_texts`: texts of an autopilot on its position and attitude, as suspect stretches.
- `constant_sensors`: sensors whose values never change although the aircraft moved.
- `contradictions`: the suspect stretches of a flight by all of this evidence.
- `exposure_places`: the place that a log has of each exposure, compared with the station.
- `filter_health`: health of a filter and second attitudes, as suspect stretches.
- `impossible_samples`: readings that cannot be true, and units that are probably wrong.
- `imported_channels`: channels that other programs made, compared with the log.
- `log_accuracy`: how accurate positions and attitudes are, by what the log reports.
- `messages`: the codes, messages and refusals of all these.
- `replacements`: a source of position or height replaced where it is plainly wrong.
- `source_differences`: two sources of position or height that differ by more than lag and offset.
- `sources`: the sources of position and height, and steps that no vehicle makes.
- `stretches`: stretches in which evidence contradicts a quantity, and their stations.
"""
