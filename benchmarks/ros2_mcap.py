"""MCAP of ROS 2 against mcap-ros2-support: ratios within one run, on a log grown to 100 MB or more.

    python benchmarks/ros2_mcap.py LOG.mcap [MEGABYTES] [PAIRS]

The library decodes the log as it was, we decode what it grew to: rates are compared.
"""

import struct
import sys
import tempfile
from pathlib import Path

from timing import Rates, seconds

from unbend.ingest import open_log
from unbend.ingest.mcap.mcap_log import read_log
from unbend.ingest.mcap.topic_samples import SCHEMAS, message_name
from unbend.messages import Ledger

STAMP = struct.Struct("<iI")  # header.stamp, behind four bytes of encapsulation
SECOND = 10**9


def grow(log: Path, out: Path, size_bytes: int) -> int:
    """Repeat a log until it has so many bytes, as one long flight; the number of messages.

    Stamps move on by the length of the log with every copy. Only little-endian CDR whose first
    field is a header, as of all messages that we read.
    """
    from mcap.reader import make_reader
    from mcap.writer import Writer

    with log.open("rb") as stream:
        reader = make_reader(stream)
        rows = list(reader.iter_messages(log_time_order=False))
    times = [message.log_time for _, _, message in rows]
    length_s = (max(times) - min(times)) // SECOND + 1
    count = 0
    with out.open("wb") as stream:
        writer = Writer(stream)
        numbers = {}
        writer.start(profile="ros2", library="unbend benchmark")
        later_s = 0
        while stream.tell() < size_bytes:
            for schema, channel, message in rows:
                if channel.id not in numbers:
                    number = writer.register_schema(schema.name, schema.encoding, schema.data)
                    numbers[channel.id] = writer.register_channel(
                        channel.topic,
                        channel.message_encoding,
                        number,
                    )
                data = message.data
                if message_name(schema.name) in SCHEMAS:
                    sec, nanosec = STAMP.unpack_from(data, 4)
                    data = data[:4] + STAMP.pack(sec + later_s, nanosec) + data[12:]
                time_ns = message.log_time + later_s * SECOND
                writer.add_message(
                    numbers[channel.id],
                    log_time=time_ns,
                    data=data,
                    publish_time=time_ns,
                    sequence=message.sequence,
                )
                count += 1
            later_s += length_s
        writer.finish()
    return count


def library(log: Path, topics: list[str]) -> int:
    """mcap-ros2-support, the wanted topics; how many messages it has decoded."""
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    with log.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        decoded = reader.iter_decoded_messages(topics, log_time_order=False)
        return sum(1 for _ in decoded)


def ours(log: Path) -> int:
    """The same topics as channels; how many messages that is."""
    return sum(len(channel) for channel in read_log(log, Ledger()).channels)


def main(source: Path, megabytes: int = 110, pairs: int = 7):
    """Print the ratio of the rates and its spread."""
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "grown.mcap"
        count = grow(source, log, megabytes * 1_000_000)
        topics = [channel.name for channel in open_log(log).channels]
        size = log.stat().st_size / 1e6
        print(
            f"{source.name} grown to {size:.0f} MB, {count:,} messages, {ours(log):,} of them in "
            f"{len(topics)} topics"
        )
        rates = Rates.by_turns(lambda: library(source, topics), lambda: ours(log), pairs)
        library_rate, our_rate = rates.medians(1e3)
        print(rates.ratio("mcap-ros2-support"))
        print(f"{library_rate:.0f} and {our_rate:.0f} thousand messages a second")
        print(f"open_log, channels, hash and all: {seconds(lambda: open_log(log)):.2f} s")


if __name__ == "__main__":
    main(Path(sys.argv[1]), *map(int, sys.argv[2:]))
