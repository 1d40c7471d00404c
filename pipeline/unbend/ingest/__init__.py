"""Log files of any format -> channels in SI and UTC."""

from unbend.ingest.flight_log import Log, hash_file
from unbend.ingest.registry import open_log

__all__ = ["Log", "hash_file", "open_log"]
