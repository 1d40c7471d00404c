"""Stations and footprints as KML 2.2: heights above sea level, footprints on the ground."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from pipeline.flight.stations import station_columns
from pipeline.ledger import Ledger
from pipeline.tables.exports.footprints import footprints, placed_stations
from pipeline.tables.exports.format import ExportFormat, FinishedRun, Values


def _write(run: FinishedRun, _: Values, path: Path, ledger: Ledger) -> int:
    """A placemark for each station with a place and one for each footprint, in two folders."""
    root = ElementTree.Element("kml", xmlns="http://www.opengis.net/kml/2.2")
    document = ElementTree.SubElement(root, "Document")
    _text(document, "name", run.mission)
    stations, grounds = (_folder(document, name) for name in ("stations", "footprints"))
    columns = station_columns(run.stations)
    corners, count = footprints(run, ledger), 0
    known = np.isfinite(columns["lat_deg"]) & np.isfinite(columns["h_msl_m"])
    for row in placed_stations(run, known, "position above sea level", ledger):
        lon, lat, h = (float(columns[name][row]) for name in ("lon_deg", "lat_deg", "h_msl_m"))
        mark = _placemark(stations, columns["image"][row])
        reason = columns["suspect_reason"][row]
        words = [columns["camera"][row], columns["status"][row], *([reason] if reason else [])]
        _text(mark, "description", ", ".join(words))
        if not np.isnat(columns["time_utc"][row]):
            when = np.datetime_as_string(columns["time_utc"][row], unit="ms")
            _text(ElementTree.SubElement(mark, "TimeStamp"), "when", f"{when}Z")
        point = ElementTree.SubElement(mark, "Point")
        _text(point, "altitudeMode", "absolute")  # above sea level, by definition of KML
        _text(point, "coordinates", f"{lon!r},{lat!r},{h!r}")
        count += 1
        if np.isfinite(corners[row]).all():
            polygon = ElementTree.SubElement(_placemark(grounds, columns["image"][row]), "Polygon")
            boundary = ElementTree.SubElement(polygon, "outerBoundaryIs")
            ring = [*corners[row].tolist(), corners[row, 0].tolist()]
            places = " ".join(f"{x!r},{y!r}" for x, y in ring)
            _text(ElementTree.SubElement(boundary, "LinearRing"), "coordinates", places)
            count += 1
    ElementTree.indent(root)
    ElementTree.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)
    return count


def _folder(parent: ElementTree.Element, name: str) -> ElementTree.Element:
    folder = ElementTree.SubElement(parent, "Folder")
    _text(folder, "name", name)
    return folder


def _placemark(parent: ElementTree.Element, name: str) -> ElementTree.Element:
    mark = ElementTree.SubElement(parent, "Placemark")
    _text(mark, "name", name)
    return mark


def _text(parent: ElementTree.Element, tag: str, text: str) -> None:
    """A child with a text; XML has no control characters, not even escaped."""
    child = ElementTree.SubElement(parent, tag)
    child.text = "".join(c if c >= " " or c in "\t\n" else "\ufffd" for c in text)


FORMATS = (ExportFormat("kml", "stations and footprints", ".kml", _write),)
