"""The list of log formats; opens a log and recognizes its format by the content."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from unbend.errors import LogError
from unbend.flight.evidence.impossible_samples import mask_impossible_values
from unbend.ingest import messages
from unbend.ingest.buffers import release_pages
from unbend.ingest.dataflash.binary_log import DATAFLASH
from unbend.ingest.dataflash.text_log import DATAFLASH_TEXT
from unbend.ingest.flight_log import Contents, Log, LogFormat, hash_file
from unbend.ingest.mcap.mcap_log import MCAP
from unbend.ingest.possible_dates import with_possible_dates
from unbend.ingest.receiver_delay import with_receiver_delay
from unbend.ingest.tlog.telemetry_log import TLOG
from unbend.ingest.ulog.px4_log import ULOG
from unbend.ingest.utc_evidence import Witness, date_in_name
from unbend.messages import Ledger

# In the order in which they are tried: formats with the most distinctive first bytes come first.
FORMATS: tuple[LogFormat, ...] = (MCAP, ULOG, DATAFLASH, DATAFLASH_TEXT, TLOG)

HEAD_BYTES = 1 << 16  # read to recognize the format
SUFFIXES = tuple(suffix for form in FORMATS for suffix in form.extensions)  # lower case, with dot
KNOWN = ", ".join(f"{form.title} ({' '.join(form.extensions)})" for form in FORMATS)

LISTED_DAMAGE = 2  # most entries of the ledger in the refusal of a file without a message
LISTED_TYPES = 12  # most message types in the refusal of a log without a wanted message


class RelatedFormat(NamedTuple):
    """A format that is not read: its first bytes, its name, and how to convert a file."""

    mark: bytes
    kind: str
    remedy: str


_RELATED_FORMATS = (
    RelatedFormat(b"#ROSBAG", "a ROS 1 bag", "convert it to MCAP with ROS 2 messages"),
    RelatedFormat(
        b"SQLite format 3", "a ROS 2 bag in SQLite", "run: ros2 bag convert, with storage_id mcap"
    ),
    RelatedFormat(b"\x1f\x8b", "compressed with gzip", "unpack it first"),
    RelatedFormat(b"PK\x03\x04", "a ZIP archive", "unpack it first"),
)


def open_log(
    path: Path | str,
    sha256: str | None = None,
    *,
    needs_channels: bool = True,
    date_ns: int | None = None,
) -> Log:
    """Read a flight log of any format in `FORMATS`; its content and its extension have to agree.

    ``sha256``: the hash of the file, if already known. ``needs_channels``: True refuses a log
    without a channel of measurements. ``date_ns``: the date of the flight [Unix ns], if the mission
    file states it. A damaged log is not refused: the damage is counted in its ledger. The start and
    the end of a log without channels are 0.
    Raises LogError (LOG-MISSING, LOG-EMPTY, LOG-FORMAT, LOG-NO-MESSAGES, LOG-UNREADABLE,
    LOG-CHANGED, LOG-TOO-LARGE; of PX4 logs LOG-ULOG) when nothing can be used.
    """
    path = Path(path)
    ledger = Ledger()
    try:
        _check_file(path)
        size = path.stat().st_size
        if size == 0:
            raise messages.log_empty(path=str(path))
        with path.open("rb") as stream:
            head = stream.read(HEAD_BYTES)
        form = _format_of(path, head)
        # The hash is computed before the file is read, so that a later change of the file is
        # detected. A file with a damaged head may not be a log: it is hashed only after reading.
        if form.matches(head) and not sha256:
            sha256 = hash_file(path)
        witnesses = _witnesses(path, date_ns)
        contents = _read(form, path, witnesses, ledger, needs_channels=needs_channels)
        if not sha256:
            sha256 = hash_file(path)
    except OSError as error:
        reason = error.strerror or str(error)
        raise messages.log_unreadable(path=str(path), reason=reason) from error
    except LogError as error:
        if error.where:  # already names the file
            raise
        raise error.as_kind(LogError, where=path) from error
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


def is_log(path: Path) -> bool:
    """Whether the first bytes of a file are those of a log; False if it cannot be read."""
    try:
        if not path.is_file():
            return False
        with path.open("rb") as stream:
            head = stream.read(HEAD_BYTES)
    except OSError:
        return False
    return format_of_head(head) is not None


def format_of_head(head: bytes) -> LogFormat | None:
    """The format of a log by its first bytes; None if these are of no known format."""
    return next((form for form in FORMATS if form.matches(head)), None)


def _check_file(path: Path) -> None:
    """Raise LogError (LOG-MISSING) unless the path is that of a file."""
    if path.is_file():
        return
    if not path.exists():
        reason = "there is no such file"
    elif path.is_dir():
        reason = "it is a folder"
    else:
        reason = "it is a pipe or a device, not a file"
    raise messages.log_missing(path=str(path), what=reason)


def _format_of(path: Path, head: bytes) -> LogFormat:
    """The format of a file by its first bytes; by its extension if these are of no known format.

    Raises LogError (LOG-FORMAT) if the first bytes are of another format than the extension, if
    they are of a related format that is not read, and if neither is known.
    """
    extension = path.suffix.lower()
    by_extension = next((form for form in FORMATS if extension in form.extensions), None)
    by_content = format_of_head(head)
    if by_content is not None and by_content is not by_extension:
        raise messages.wrong_extension(
            path=str(path),
            title=by_content.title,
            extension=extension,
            usual=by_content.extensions[0],
        )
    if by_content is None:
        for related in _RELATED_FORMATS:
            if head.startswith(related.mark):
                raise messages.needs_conversion(
                    path=str(path), kind=related.kind, remedy=related.remedy
                )
    if by_extension is None:
        raise messages.unknown_format(path=str(path), extension=extension, known=KNOWN)
    return by_extension  # a log with a damaged beginning: its reader decides


def _witnesses(path: Path, date_ns: int | None) -> list[Witness]:
    """The sources of the date outside the log: the mission file, and the name of the file."""
    witnesses = []
    if date_ns is not None:
        witnesses.append(Witness("mission.date", date_ns))
    name_witness = date_in_name(path.name)
    if name_witness is not None:
        witnesses.append(name_witness)
    return witnesses


def _read(
    form: LogFormat,
    path: Path,
    witnesses: Sequence[Witness],
    ledger: Ledger,
    *,
    needs_channels: bool,
) -> Contents:
    """Read a log, correct its times, and check and sort its channels.

    Raises LogError if it has no message, or none that is wanted (only if ``needs_channels``).
    """
    decoded = form.read(path, ledger, witnesses)
    contents = with_possible_dates(decoded, witnesses, ledger)
    channels = []
    for channel in contents.channels:
        checked = ledger.take(mask_impossible_values(channel))
        if len(checked):
            channels.append(checked)
        release_pages()
    channels.sort(key=lambda channel: channel.name)
    if not contents.messages:
        raise messages.no_whole_message(
            path=str(path),
            title=form.title,
            size=path.stat().st_size,
            damage=list(ledger)[:LISTED_DAMAGE],
            known=KNOWN,
        )
    has_measurements = any(not channel.is_evidence for channel in channels)
    if needs_channels and not has_measurements:
        raise messages.no_wanted_messages(
            path=str(path),
            total=sum(contents.messages.values()),
            kinds=sorted(contents.messages)[:LISTED_TYPES],
            unread=contents.unread_encodings,
        )
    counts = dict(sorted(contents.messages.items()))
    checked_contents = replace(contents, messages=counts, channels=tuple(channels))
    return with_receiver_delay(checked_contents, ledger)
