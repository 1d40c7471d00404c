"""Which formats there are, and opening a log by its content."""

from dataclasses import replace
from pathlib import Path

from unbend.errors import LogError
from unbend.flight.evidence.quality import mask_impossible_values
from unbend.ingest.buffers import release_pages
from unbend.ingest.dataflash.binary_log import DATAFLASH
from unbend.ingest.dataflash.text_log import DATAFLASH_TEXT
from unbend.ingest.flight_log import Contents, Log, LogFormat, hash_file
from unbend.ingest.mcap.mcap_log import MCAP
from unbend.ingest.receiver_delay import with_receiver_delay
from unbend.ingest.tlog.telemetry_log import TLOG
from unbend.ingest.ulog.px4_log import ULOG
from unbend.messages import Ledger

# the surest mark first
FORMATS: tuple[LogFormat, ...] = (MCAP, ULOG, DATAFLASH, DATAFLASH_TEXT, TLOG)

HEAD_BYTES = 1 << 16
SUFFIXES = tuple(suffix for form in FORMATS for suffix in form.extensions)  # lower case, with dot
KNOWN = ", ".join(f"{form.title} ({' '.join(form.extensions)})" for form in FORMATS)

# Related files that cannot be read, by their first bytes, and how to convert them.
_UNREADABLE = (
    (b"#ROSBAG", "a ROS 1 bag", "convert it to MCAP with ROS 2 messages"),
    (b"SQLite format 3", "a ROS 2 bag in SQLite", "run: ros2 bag convert, with storage_id mcap"),
    (b"\x1f\x8b", "compressed with gzip", "unpack it first"),
    (b"PK\x03\x04", "a ZIP archive", "unpack it first"),
)


def open_log(path: Path | str, sha256: str | None = None, *, needs_channels: bool = True) -> Log:
    """Read a flight log of any format in `FORMATS`; its content and its extension have to agree.

    ``sha256``: its hash, if already taken. ``needs_channels``: refuse a log without any; without
    them start and end are 0. Damage is no reason to refuse: it is counted in the ledger of the log.
    Raises LogError (LOG-MISSING, LOG-EMPTY, LOG-FORMAT, LOG-NO-MESSAGES, LOG-UNREADABLE,
    LOG-CHANGED; of PX4 logs LOG-ULOG) when nothing can be used.
    """
    path = Path(path)
    try:
        if not path.is_file():
            kind = "it is a folder" if path.is_dir() else "it is a pipe or a device, not a file"
            what = kind if path.exists() else "there is no such file"
            raise LogError("LOG-MISSING", what, where=str(path), remedy="check the path of the log")
        size = path.stat().st_size
        if size == 0:
            remedy = "copy it again from the vehicle or the ground station"
            raise LogError("LOG-EMPTY", "the file has 0 bytes", where=str(path), remedy=remedy)
        with path.open("rb") as stream:
            head = stream.read(HEAD_BYTES)
        form = _format_of(path, head)
        if form.matches(head):  # otherwise only reading it shows whether it is a log at all
            sha256 = sha256 or hash_file(path)
        ledger = Ledger()
        contents = _read(form, path, ledger, needs_channels)
        sha256 = sha256 or hash_file(path)
    except OSError as error:
        raise LogError.of("LOG-UNREADABLE", path, error=error.strerror or error) from error
    channels = contents.channels
    return Log(
        **vars(contents),
        path=path,
        format=form.name,
        sha256=sha256,
        size_bytes=size,
        start_ns=min((int(channel.time_ns[0]) for channel in channels), default=0),
        end_ns=max((int(channel.time_ns[-1]) for channel in channels), default=0),
        ledger=ledger,
    )


def _format_of(path: Path, head: bytes) -> LogFormat:
    extension = path.suffix.lower()
    named = next((form for form in FORMATS if extension in form.extensions), None)
    actual = next((form for form in FORMATS if form.matches(head)), None)
    if actual is not None and actual is not named:
        what = f"its content is {actual.title}, its extension is {extension or 'missing'}"
        remedy = f"rename it to end in {actual.extensions[0]} if this is the intended log"
        raise LogError("LOG-FORMAT", what, where=str(path), remedy=remedy)
    for mark, what, remedy in _UNREADABLE:
        if actual is None and head.startswith(mark):
            raise LogError("LOG-FORMAT", f"the file is {what}", where=str(path), remedy=remedy)
    if named is None:
        what = f"neither content nor extension ({extension or 'none'}) is one of a known format"
        raise LogError("LOG-FORMAT", what, where=str(path), remedy=f"give one of {KNOWN}")
    return named  # a log with a damaged beginning: its reader decides


def _read(form: LogFormat, path: Path, ledger: Ledger, needs_channels: bool) -> Contents:
    """The contents of a log with its channels checked and sorted; LogError if nothing is usable."""
    contents = form.read(path, ledger)
    channels = []
    for channel in contents.channels:
        channels.append(ledger.take(mask_impossible_values(channel)))
        release_pages()
    channels = sorted((c for c in channels if len(c)), key=lambda channel: channel.name)
    if not contents.messages:
        damage = "".join(f"; {entry.what} ({entry.where})" for entry in list(ledger)[:2])
        what = f"no whole message of {form.title} in {path.stat().st_size} bytes{damage}"
        remedy = f"check that it is the whole log; known are {KNOWN}"
        raise LogError("LOG-FORMAT", what, where=str(path), remedy=remedy)
    if needs_channels and all(channel.is_evidence for channel in channels):
        kinds, total = ", ".join(sorted(contents.messages)[:12]), sum(contents.messages.values())
        raise LogError.of("LOG-NO-MESSAGES", path, total=total, kinds=kinds)
    messages = dict(sorted(contents.messages.items()))
    contents = replace(contents, messages=messages, channels=tuple(channels))
    return with_receiver_delay(contents, ledger)
