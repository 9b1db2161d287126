//! The messages of one topic as the text of a table, for the reader of foreign recordings: a header line, and a row of numbers for each
//! message. A damaged message is a line that says so.

use std::fmt::Write as _;
use std::io::{self, ErrorKind, Read};

use super::bag_reader::{BagChannel, BagError, BagReader};
use super::sensor_messages::{MessageContent, RowOptions, SensorType, TIME_COLUMNS, TopicRefusal, decode};
use super::summary::sensor_of;

/// Begins a line that stands for a damaged message, or for what is missing of the bag; what was wrong follows.
pub(crate) const DAMAGED: char = '!';

/// A topic, and what is taken of its messages.
#[derive(Clone, Debug, PartialEq)]
pub struct BagTopic {
    pub name: String,
    /// Names of the joints of the left and the right wheel; `None` takes the first with `left` and `right` in them.
    pub joints: Option<[String; 2]>,
    /// Direction of the range of a scan, counter-clockwise from forward.
    pub bearing_rad: f64,
}

/// Reads the text of the table from the bytes of a bag.
pub struct TopicTable<R> {
    bag: BagReader<R>,
    topic: String,
    options: RowOptions,
    /// From the first message of the topic on.
    sensor: Option<SensorType>,
    is_finished: bool,
    text: String,
    /// Of `text`, read so far.
    read: usize,
}

impl<R: Read> TopicTable<R> {
    /// # Errors
    /// Reading failed, or the bytes are not those of an MCAP file.
    pub fn open(input: R, topic: &BagTopic) -> Result<Self, BagError> {
        Ok(Self {
            bag: BagReader::open(input)?,
            topic: topic.name.clone(),
            options: RowOptions { joints: topic.joints.clone(), bearing_rad: topic.bearing_rad },
            sensor: None,
            is_finished: false,
            text: String::new(),
            read: 0,
        })
    }

    /// The next lines; false at the end.
    fn advance(&mut self) -> io::Result<bool> {
        self.text.clear();
        self.read = 0;
        while let Some(message) = self.bag.next()? {
            if message.channel.topic != self.topic {
                continue;
            }
            let sensor = if let Some(sensor) = self.sensor {
                sensor
            } else {
                let sensor = sensor_of(message.channel).map_err(|why| refused(&self.topic, message.channel, why))?;
                _ = writeln!(self.text, "{TIME_COLUMNS},{}", sensor.columns());
                *self.sensor.insert(sensor)
            };
            match decode(sensor, &self.options, message.data) {
                Ok(MessageContent::Row(row)) => {
                    _ = write!(self.text, "{},{}", row.stamp_nanos, message.log_nanos);
                    for value in row.values {
                        // An empty field is no number, which the reader of the table reports.
                        _ = if value.is_finite() { write!(self.text, ",{value}") } else { write!(self.text, ",") };
                    }
                    self.text.push('\n');
                }
                Ok(MessageContent::Nothing) => {}
                Err(error) => _ = writeln!(self.text, "{DAMAGED}byte {} of the bag: {error}", message.offset),
            }
            if !self.text.is_empty() {
                return Ok(true);
            }
        }
        if self.sensor.is_none() {
            return Err(self.missing());
        }
        let faults = self.bag.faults();
        let is_damaged = !self.is_finished && faults.count > 0;
        self.is_finished = true;
        if let Some(first) = faults.listed.first().filter(|_| is_damaged) {
            let further = match faults.count - 1 {
                0 => String::new(),
                count => format!("; and {count} further places"),
            };
            _ = writeln!(self.text, "{DAMAGED}part of the bag could not be read: {first}{further}");
        }
        Ok(is_damaged)
    }

    /// The error for a topic without messages; it lists those that there are.
    fn missing(&self) -> io::Error {
        let known: Vec<&str> = self.bag.channels().map(|channel| channel.topic.as_str()).take(50).collect();
        let what = format!("the bag has no message of the topic {}; there are: {}", self.topic, known.join(", "));
        io::Error::new(ErrorKind::InvalidData, what)
    }
}

fn refused(topic: &str, channel: &BagChannel, refusal: TopicRefusal) -> io::Error {
    let kind = channel.schema.as_deref().map_or("unknown", |schema| schema.name.as_str());
    let why = match refusal {
        TopicRefusal::OtherType => "is not read".to_owned(),
        TopicRefusal::Unreadable(why) => format!("cannot be read: {why}"),
    };
    io::Error::new(ErrorKind::InvalidData, format!("the topic {topic} ({kind}) {why}"))
}

impl<R: Read> Read for TopicTable<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.read == self.text.len() && !self.advance()? {
            return Ok(0);
        }
        let rest = self.text.as_bytes().get(self.read..).unwrap_or_default();
        let count = rest.len().min(buffer.len());
        buffer[..count].copy_from_slice(&rest[..count]);
        self.read += count;
        Ok(count)
    }
}
