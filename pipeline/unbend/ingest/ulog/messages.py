"""Messages of the reader of PX4 logs: codes, and a function for each message and refusal."""

from unbend.errors import Code, Counted, LogError
from unbend.ingest.messages import LOG_DROPOUT, LOG_GAP
from unbend.messages import Message, finding, loss, warning

LOG_ULOG = Code(
    "LOG-ULOG",
    means="The file is not a ULog, or needs a newer reader.",
    effect="The log is refused.",
    remedy="Check that the log is complete, or convert it with a newer tool of PX4.",
)


def header_cut_off(*, path: str, size: int, header_size: int) -> LogError:
    """The file is shorter than its header."""
    return LogError(
        LOG_ULOG,
        "it ends after {size} of {header_size} bytes of its header",
        where=path,
        remedy="copy it again from the vehicle",
        size=size,
        header_size=header_size,
    )


def unknown_flags(*, path: str, flags: bytes) -> LogError:
    """Flags of the file state that a reader that does not know them must not read it."""
    return LogError(
        LOG_ULOG,
        "it sets incompatible flags ({flags}) that this version does not know",
        where=path,
        remedy="copy it again from the vehicle, or convert it with a newer tool of PX4",
        flags=flags.hex(),
    )


LOG_ULOG_DAMAGE = Code(
    "LOG-ULOG-DAMAGE",
    means="Values of parameters or information do not have the length of their type.",
    effect="They are not used. The amount of lost data is unknown.",
    remedy="Copy the log again.",
)


def damaged_values(*, file: str, count: int) -> Message:
    """Parameters or information of a wrong length."""
    return loss(
        LOG_ULOG_DAMAGE,
        (
            "{count} values of parameters or of information do not have the length of their type; "
            "the number of lost messages is unknown"
        ),
        one=(
            "1 value of a parameter or of information does not have the length of its type; the "
            "number of lost messages is unknown"
        ),
        where=file,
        count=count,
    )


def logger_dropouts(*, file: str, count: int, seconds: float) -> Message:
    """The logger reports that it lost data."""
    return finding(
        LOG_DROPOUT,
        "the log is incomplete: the logger could not keep up {times}, {seconds:.3f} s together",
        where=file,
        count=count,
        times=Counted(count, "time"),
        seconds=seconds,
    )


def messages_cut_out(
    *, file: str, after_boot_s: float, count: int, seconds: float, missing: int
) -> Message:
    """Several times, or once, no topic has a message, ``seconds`` in total.

    ``missing``: about how many messages usually come in this time.
    """
    return finding(
        LOG_GAP,
        "the log is incomplete: {times} nothing was logged, {seconds:.3f} s together, about "
        "{missing}: they were cut out, or the logger stopped",
        where=f"{file}, first {after_boot_s:.3f} s after boot",
        count=count,
        times=Counted(count, "time"),
        seconds=seconds,
        missing=Counted(missing, "message"),
    )


LOG_PAUSED = Code(
    "LOG-PAUSED",
    means="For most of its time the log has no message of any topic.",
    effect="Exposures there have no station (in_gap); nothing shows that messages are missing.",
    remedy="If exposures are in these times, check when the vehicle logs (SDLOG_MODE).",
)


def logged_now_and_then(
    *, file: str, after_boot_s: float, count: int, seconds: float, logged_s: float
) -> Message:
    """Most of the time nothing was logged: the logger was not running."""
    return warning(
        LOG_PAUSED,
        (
            "{times} nothing was logged, {seconds:.3f} s in total, compared with {logged_s:.3f} s "
            "of log: the logger was not running all the time"
        ),
        where=f"{file}, first {after_boot_s:.3f} s after boot",
        count=count,
        times=Counted(count, "time"),
        seconds=seconds,
        logged_s=logged_s,
    )
