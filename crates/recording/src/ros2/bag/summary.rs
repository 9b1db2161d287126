//! What a bag holds: its topics with what their messages say, from one pass over it.

use std::collections::BTreeMap;
use std::io::Read;

use super::bag_reader::{BagChannel, BagError, BagReader, Faults};
use super::sensor_messages::{MessageContent, RowOptions, SensorRow, SensorType, TopicRefusal, decode};

/// A channel may change its topic with every message: this bounds the memory.
const MAX_TOPICS: usize = 4_096;

/// A topic of a bag.
#[derive(Clone, Debug, PartialEq)]
pub struct TopicSummary {
    pub name: String,
    /// As its schema has it; empty without one.
    pub type_name: String,
    /// All messages.
    pub messages: u64,
    /// Why none of its messages can be taken; `None` if they can, or if no sensor has messages of this type.
    pub(super) refusal: Option<String>,
    pub(super) sensor: Option<SensorType>,
    /// Messages with numbers.
    pub(super) rows: u64,
    pub(super) facts: TopicFacts,
    /// The first damaged message, with its byte, and the number of all.
    pub(super) damaged: Faults,
}

/// What the messages of a topic have in common.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct TopicFacts {
    /// The frame of the first message.
    pub(super) frame: String,
    pub(super) frame_changes: bool,
    /// The joints of the first message.
    pub(super) joints: Option<[String; 2]>,
    /// The earliest log time.
    pub(super) log_nanos: i64,
    /// The earliest stamp.
    pub(super) stamp_nanos: i64,
    /// Whether any stamp is not zero.
    pub(super) has_stamps: bool,
    pub(super) values: Vec<ValueFacts>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ValueFacts {
    pub(super) varies: bool,
    pub(super) is_always_positive: bool,
    pub(super) first: f64,
    pub(super) sum: f64,
}

/// The topics of a bag, by name.
#[derive(Clone, Debug, PartialEq)]
pub struct BagSummary {
    pub topics: Vec<TopicSummary>,
    /// What could not be read.
    faults: Faults,
}

impl BagSummary {
    /// # Errors
    /// Reading failed, or the bytes are not those of an MCAP file. What is damaged in it is in [`Self::notes`].
    pub fn read(input: impl Read) -> Result<Self, BagError> {
        let mut reader = BagReader::open(input)?;
        let mut topics: BTreeMap<String, TopicSummary> = BTreeMap::new();
        let mut left_out = 0_u64;
        while let Some(message) = reader.next()? {
            if topics.len() >= MAX_TOPICS && !topics.contains_key(&message.channel.topic) {
                left_out += 1;
                continue;
            }
            let known = match topics.get_mut(&message.channel.topic) {
                Some(known) => known,
                None => {
                    topics.entry(message.channel.topic.clone()).or_insert_with(|| TopicSummary::new(message.channel))
                }
            };
            known.observe(message.data, message.log_nanos, message.offset);
        }
        let room = MAX_TOPICS.saturating_sub(topics.len());
        for channel in reader.channels().take(room) {
            topics.entry(channel.topic.clone()).or_insert_with(|| TopicSummary::new(channel));
        }
        let mut faults = reader.faults().clone();
        if left_out > 0 {
            faults.push(format!("{left_out} messages of topics beyond the first {MAX_TOPICS}"));
        }
        Ok(Self { topics: topics.into_values().collect(), faults })
    }

    #[cfg(test)]
    pub(super) fn of_topics(topics: Vec<TopicSummary>) -> Self {
        Self { topics, faults: Faults::default() }
    }

    /// What could not be read, a line each.
    pub fn notes(&self) -> Vec<String> {
        let mut notes = self.faults.listed.clone();
        let further = self.faults.count - notes.len() as u64;
        if further > 0 {
            notes.push(format!("and {further} further places in the bag could not be read"));
        }
        for topic in &self.topics {
            if let Some(first) = topic.damaged.listed.first() {
                notes.push(format!(
                    "{}: {} damaged messages are left out; the first: {first}",
                    topic.name, topic.damaged.count
                ));
            }
        }
        notes
    }
}

impl TopicSummary {
    fn new(channel: &BagChannel) -> Self {
        let type_name = channel.schema.as_ref().map_or_else(String::new, |schema| schema.name.clone());
        let (sensor, refusal) = match sensor_of(channel) {
            Ok(sensor) => (Some(sensor), None),
            Err(TopicRefusal::OtherType) => (None, None),
            Err(TopicRefusal::Unreadable(why)) => (None, Some(why)),
        };
        Self {
            name: channel.topic.clone(),
            type_name,
            messages: 0,
            refusal,
            sensor,
            rows: 0,
            facts: TopicFacts::default(),
            damaged: Faults::default(),
        }
    }

    fn observe(&mut self, data: &[u8], log_nanos: u64, offset: u64) {
        self.messages += 1;
        let Some(sensor) = self.sensor else {
            return;
        };
        match decode(sensor, &RowOptions::default(), data) {
            Ok(MessageContent::Row(row)) => {
                self.facts.observe(row, i64::try_from(log_nanos).unwrap_or(i64::MAX));
                self.rows += 1;
            }
            Ok(MessageContent::Nothing) => {}
            Err(error) => self.damaged.push(format!("byte {offset} of the bag: {error}")),
        }
    }
}

impl TopicFacts {
    /// The earliest time of the sender; the log time where it set none.
    pub(super) const fn time_nanos(&self) -> i64 {
        if self.has_stamps { self.stamp_nanos } else { self.log_nanos }
    }

    fn observe(&mut self, row: SensorRow, log_nanos: i64) {
        let stamp_nanos = row.stamp_nanos;
        if self.values.is_empty() {
            self.values = row.values.iter().map(|value| ValueFacts::new(*value)).collect();
            (self.log_nanos, self.stamp_nanos) = (log_nanos, stamp_nanos);
            self.frame.clone_from(&row.frame);
            self.joints = row.joints;
        }
        self.log_nanos = self.log_nanos.min(log_nanos);
        self.stamp_nanos = self.stamp_nanos.min(stamp_nanos);
        self.has_stamps |= stamp_nanos != 0;
        self.frame_changes |= row.frame != self.frame;
        for (facts, value) in self.values.iter_mut().zip(row.values) {
            facts.varies |= value.is_finite() && facts.first.is_finite() && value != facts.first;
            facts.is_always_positive &= value > 0.0;
            facts.sum += if value.is_finite() { value } else { 0.0 };
        }
    }
}

impl ValueFacts {
    const fn new(first: f64) -> Self {
        Self { varies: false, is_always_positive: true, first, sum: 0.0 }
    }
}

pub(super) fn sensor_of(channel: &BagChannel) -> Result<SensorType, TopicRefusal> {
    let Some(schema) = &channel.schema else {
        return Err(TopicRefusal::Unreadable("the bag has no schema for it".to_owned()));
    };
    let sensor = SensorType::of_schema(schema)?;
    if channel.message_encoding != "cdr" {
        let encoding = channel.message_encoding.chars().take(40).collect::<String>();
        let why = format!("its messages are `{}` and not cdr", encoding.escape_default());
        return Err(TopicRefusal::Unreadable(why));
    }
    Ok(sensor)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn facts_of(rows: &[(i64, f64)]) -> TopicFacts {
        let mut facts = TopicFacts::default();
        for (stamp_nanos, value) in rows {
            let row = SensorRow { stamp_nanos: *stamp_nanos, frame: String::new(), values: vec![*value], joints: None };
            facts.observe(row, 1_000);
        }
        facts
    }

    #[test]
    fn a_stamp_of_zero_is_a_time_where_others_are_not_zero() {
        assert_eq!(facts_of(&[(0, 1.0), (20, 1.0)]).time_nanos(), 0);
        assert_eq!(facts_of(&[(0, 1.0), (0, 1.0)]).time_nanos(), 1_000);
    }

    #[test]
    fn a_value_that_is_no_number_does_not_vary() {
        let nan = f64::NAN;
        for (values, varies) in [([nan, nan], false), ([nan, 1.0], false), ([1.0, 1.0], false), ([1.0, 2.0], true)] {
            assert_eq!(facts_of(&values.map(|value| (1, value))).values[0].varies, varies, "{values:?}");
        }
    }
}
