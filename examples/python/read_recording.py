#!/usr/bin/env python3
"""Reads a recording (MCAP) into pandas and writes its estimates as Parquet.

    python3 read_recording.py RECORDING.mcap [ESTIMATES.parquet]

In a notebook: `from read_recording import table, odometry`, then `table("recording.mcap", "posebridge/fusion")`.
The topics and their fields are those of docs/recording-format.md.
"""
import json
import sys

import pandas as pd
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory


def topics(recording):
    """How many messages each topic has, and by which schema."""
    with open(recording, "rb") as file:
        summary = make_reader(file).get_summary()
    counts = summary.statistics.channel_message_counts
    rows = [(channel.topic, summary.schemas[channel.schema_id].name, counts.get(key, 0)) for key, channel in summary.channels.items()]
    return pd.DataFrame(rows, columns=["topic", "schema", "messages"]).set_index("topic").sort_index()


def table(recording, topic):
    """A topic of JSON records: a row for each, by UTC."""
    with open(recording, "rb") as file:
        rows = [{"utc": message.log_time, **json.loads(message.data)} for _, _, message in make_reader(file).iter_messages(topics=[topic])]
    return by_utc(rows)


def odometry(recording):
    """The poses that Foxglove draws, out of the protocol buffers of `foxglove.Odometry`."""
    with open(recording, "rb") as file:
        decoded = make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages(topics=["/posebridge/odometry"])
        rows = [
            {"utc": message.log_time, "x_m": odometry.pose.position.x, "y_m": odometry.pose.position.y}
            for _, _, message, odometry in decoded
        ]
    return by_utc(rows)


def by_utc(rows):
    """A table of rows with nanoseconds since 1970."""
    frame = pd.DataFrame(rows)
    frame["utc"] = pd.to_datetime(frame["utc"], utc=True)
    return frame.set_index("utc")


def main(recording, parquet="estimates.parquet"):
    print(topics(recording).to_string())
    estimates = table(recording, "posebridge/estimate")
    print(estimates[["x_m", "y_m", "x_sigma_m", "y_sigma_m", "heading_sigma_rad"]].describe().to_string())
    estimates.to_parquet(parquet)
    print(f"{len(estimates)} estimates to {parquet}")


if __name__ == "__main__":
    main(*sys.argv[1:])
