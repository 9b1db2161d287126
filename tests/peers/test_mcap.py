"""The readers of MCAP in Python on our recordings: of one that ended, and of one whose program was killed."""

import collections
import csv
import json
import math
import os
import struct
import sys
import tempfile
import time
import unittest

import jsonschema
from mcap.exceptions import EndOfFile
from mcap.reader import NonSeekingReader, SeekingReader
from mcap.records import Message
from mcap.stream_reader import StreamReader
from mcap_protobuf.decoder import DecoderFactory

from drives import finished_drive, inspected, simulated
from harness import DEADLINE_S, RunningStation, posebridge

FOXGLOVE = {
    "/posebridge/odometry": "foxglove.Odometry",
    "/posebridge/pose": "foxglove.PoseInFrame",
    "/posebridge/path": "foxglove.PosesInFrame",
    "/posebridge/ellipse": "foxglove.SceneUpdate",
    "/tf": "foxglove.FrameTransform",
    "/camera/fix": "foxglove.PoseInFrame",
    "/log": "foxglove.Log",
    "/truth/pose": "foxglove.PoseInFrame",
}
OURS = {
    "posebridge/estimate": "posebridge.Estimate",
    "posebridge/fusion": "posebridge.Fusion",
    "posebridge/link_health": "posebridge.LinkHealth",
    "posebridge/clock": "posebridge.Clock",
    "posebridge/calibration": "posebridge.Calibration",
    "posebridge/truth": "posebridge.Truth",
}
INPUTS = "posebridge/input"
# What a killed program may have kept to itself.
LAST_S = 1.0
KILLS = 10
# How long a file is when the first program is killed, and how much longer for each that follows.
FIRST_KILL_BYTES = 40_000
BYTES_BETWEEN_KILLS = 13_000
# In how many places a recording is cut.
CUTS = 150


class Recording(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.folder = finished_drive()
        cls.path = os.path.join(cls.folder, "run", "recording.mcap")

    def reader(self, kind=SeekingReader, **options):
        file = open(self.path, "rb")
        self.addCleanup(file.close)
        return kind(file, validate_crcs=True, **options)

    def test_every_channel_has_a_schema_that_is_known(self):
        summary = self.reader().get_summary()
        found = {channel.topic: summary.schemas[channel.schema_id] for channel in summary.channels.values()}
        named = {topic: schema.name for topic, schema in found.items()}
        self.assertEqual(named, {**FOXGLOVE, **OURS, INPUTS: "posebridge.input.v1"})
        for topic, schema in found.items():
            expected = "protobuf" if topic in FOXGLOVE else "jsonschema" if topic in OURS else "posebridge.input.v1"
            self.assertEqual(schema.encoding, expected, topic)
            self.assertTrue(schema.data or topic == INPUTS, topic)

    def test_counts_are_equal_with_and_without_the_index(self):
        statistics = self.reader().get_summary().statistics
        counts = [
            collections.Counter(channel.id for _, channel, _ in self.reader(kind).iter_messages())
            for kind in (SeekingReader, NonSeekingReader)
        ]
        self.assertEqual(counts[0], counts[1])
        self.assertEqual(counts[0], {channel: count for channel, count in statistics.channel_message_counts.items() if count})
        self.assertEqual(sum(counts[0].values()), statistics.message_count)
        inputs = [message for _, _, message in self.reader().iter_messages(topics=[INPUTS])]
        self.assertEqual(len(inputs), inspected(self.folder, "run/recording.mcap")["recording"]["inputs"])
        self.assertEqual([message.sequence for message in inputs], list(range(len(inputs))))

    def test_json_validates_against_its_schema(self):
        validators, checked = {}, collections.Counter()
        for schema, channel, message in self.reader().iter_messages(topics=list(OURS)):
            if channel.topic not in validators:
                text = json.loads(schema.data)
                jsonschema.Draft7Validator.check_schema(text)
                self.assertTrue(text["properties"], channel.topic)
                validators[channel.topic] = jsonschema.Draft7Validator(text)
            record = json.loads(message.data)
            validators[channel.topic].validate(record)
            self.assertLessEqual(set(record), set(validators[channel.topic].schema["properties"]), channel.topic)
            checked[channel.topic] += 1
        self.assertEqual(set(checked), set(OURS))

    def test_protobuf_decodes_and_says_what_the_tables_say(self):
        decoded = collections.defaultdict(list)
        for _, channel, message, value in self.reader(decoder_factories=[DecoderFactory()]).iter_decoded_messages(topics=list(FOXGLOVE)):
            decoded[channel.topic].append((message.log_time, value))
        self.assertEqual(set(decoded), set(FOXGLOVE))
        records = (
            (message.log_time, json.loads(message.data)) for _, _, message in self.reader().iter_messages(topics=["posebridge/estimate"]))
        estimates = list(records)
        odometry = decoded["/posebridge/odometry"]
        self.assertGreater(len(odometry), 50)
        # Until the robot is seen its pose counts from where it started.
        frames = ["arena" if record["is_position_valid"] else "start" for _, record in estimates]
        self.assertEqual([value.frame_id for _, value in odometry], frames)
        self.assertEqual(set(frames), {"arena", "start"})
        self.assertEqual([at for at, _ in odometry], [at for at, _ in estimates])
        tables = self.tables()
        for (_, theirs), (_, ours) in zip(odometry, estimates):
            self.assertEqual((theirs.pose.position.x, theirs.pose.position.y), (ours["x_m"], ours["y_m"]))
            self.assertAlmostEqual(math.sqrt(theirs.pose_covariance[0]), ours["x_sigma_m"], delta=1e-12)
            self.assertIn((ours["brick_nanos"], theirs.pose.position.x, theirs.pose.position.y), tables)

    def tables(self):
        """Estimates of `posebridge export`: the robot's clock in nanoseconds, x and y. A late fix makes a second one for an instant."""
        posebridge(self.folder, "export", "run/recording.mcap", "--format", "csv", "--out", "tables")
        with open(os.path.join(self.folder, "tables", "estimates.csv"), newline="") as file:
            return {(round(1e9 * float(row["t_s"])), float(row["x_m"]), float(row["y_m"])) for row in csv.DictReader(file)}


class Killed(unittest.TestCase):
    def test_ten_recordings_are_read_up_to_the_last_second_after_kill_9(self):
        # Side by side, each killed at another length of its file, so that no place between two flushes passes by luck.
        alive = dict(self.station(number) for number in range(KILLS))
        sizes, torn = [], 0
        deadline = time.monotonic() + DEADLINE_S + KILLS
        while alive:
            self.assertLess(time.monotonic(), deadline, [station.talk() for station in alive.values()])
            for recording, station in list(alive.items()):
                number = KILLS - len(alive)
                if os.path.exists(recording) and os.path.getsize(recording) > FIRST_KILL_BYTES + number * BYTES_BETWEEN_KILLS:
                    del alive[recording]
                    station.kill()
                    sizes.append(os.path.getsize(recording))
                    torn += self.is_read_after_kill(recording, time.time())
        self.assertEqual(torn, KILLS)
        print(f"\n  killed at bytes {sizes}", file=sys.stderr)

    def test_a_cut_anywhere_is_an_end_and_no_defect(self):
        with open(os.path.join(finished_drive(), "run", "recording.mcap"), "rb") as file:
            whole = file.read()
        cut = tempfile.NamedTemporaryFile()
        self.addCleanup(cut.close)
        before = 0
        for length in range(FIRST_KILL_BYTES, len(whole), len(whole) // CUTS):
            with open(cut.name, "wb") as file:
                file.write(whole[:length])
            messages, _, is_torn = self.messages(cut.name)
            self.assertTrue(is_torn, length)
            self.assertGreaterEqual(len(messages), before, length)
            before = len(messages)
        self.assertGreater(before, 1000)

    def station(self, number):
        """A station with a robot that drives, and the recording that it writes."""
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        station = RunningStation(folder.name, "run", simulated(folder.name)).belongs_to(self)
        return os.path.join(folder.name, "run", "recording.mcap"), station

    def is_read_after_kill(self, recording, killed):
        """Reads a recording whose program was killed; whether it was cut off."""
        messages, inputs, is_torn = self.messages(recording)
        self.assertLess(killed - 1e-9 * messages[-1].log_time, LAST_S)
        self.assertGreater(inputs, 10)
        # Ours has an eye for what is whole in the chunk that was cut, so it may find more.
        folder, name = os.path.split(recording)
        self.assertGreaterEqual(inspected(folder, name)["recording"]["inputs"], inputs)
        return is_torn

    def messages(self, recording):
        """What can be had without an index, how many of them are inputs, and whether the end is missing."""
        found, channels, is_torn = [], {}, False
        with open(recording, "rb") as file:
            try:
                for record in StreamReader(file, validate_crcs=True).records:
                    if isinstance(record, Message):
                        found.append(record)
                    elif hasattr(record, "topic"):
                        channels[record.id] = record.topic
            except (EndOfFile, struct.error):
                # By what lacks, the next field or a part of a number, the reader notices the cut. A defect has something behind it.
                self.assertEqual(file.read(1), b"", recording)
                is_torn = True
        return found, sum(channels[message.channel_id] == INPUTS for message in found), is_torn


if __name__ == "__main__":
    unittest.main()
