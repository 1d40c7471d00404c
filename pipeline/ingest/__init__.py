"""Log files of any format -> channels in SI and UTC."""

from pipeline.ingest.log import Log, hash_file
from pipeline.ingest.registry import open_log

__all__ = ["Log", "hash_file", "open_log"]
