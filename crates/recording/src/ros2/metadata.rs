//! The file `metadata.yaml` that rosbag2 wants beside a bag's storage.
//!
//! In version 5, that of ROS 2 Humble, because later ones read it as well.

use std::collections::BTreeMap;
use std::fmt::Write as _;

/// What a publisher of each topic would have offered: reliable, volatile, the last ten. Numbers and not names of the policies: ROS 2 Humble
/// reads only these, and later ones read both.
pub(super) const QOS_PROFILES: &str = "\
- history: 1
  depth: 10
  reliability: 1
  durability: 2
  deadline:
    sec: 9223372036
    nsec: 854775807
  lifespan:
    sec: 9223372036
    nsec: 854775807
  liveliness: 1
  liveliness_lease_duration:
    sec: 9223372036
    nsec: 854775807
  avoid_ros_namespace_conventions: false";

/// What a bag holds. Times are log times, since 1970.
#[derive(Clone, Debug, Default)]
pub(super) struct BagContents {
    first_nanos: Option<u64>,
    last_nanos: u64,
    topics: BTreeMap<String, TopicContents>,
}

#[derive(Clone, Copy, Debug)]
struct TopicContents {
    message_type: &'static str,
    messages: u64,
}

impl BagContents {
    /// `nanos` never decreases.
    pub(super) fn count(&mut self, nanos: u64, topic: &str, message_type: &'static str) {
        self.first_nanos.get_or_insert(nanos);
        self.last_nanos = nanos;
        if let Some(contents) = self.topics.get_mut(topic) {
            contents.messages += 1;
        } else {
            self.topics.insert(topic.to_owned(), TopicContents { message_type, messages: 1 });
        }
    }

    pub(super) fn messages(&self) -> u64 {
        self.topics.values().map(|topic| topic.messages).sum()
    }

    /// The text of `metadata.yaml` for a bag of one file.
    pub(super) fn to_yaml(&self, file: &str) -> String {
        let (start, messages) = (self.first_nanos.unwrap_or_default(), self.messages());
        let duration = self.last_nanos.saturating_sub(start);
        let mut topics = String::new();
        for (name, TopicContents { message_type, messages }) in &self.topics {
            // Writing to a String cannot fail.
            let _ = write!(
                topics,
                "
    - topic_metadata:
        name: {name}
        type: {message_type}
        serialization_format: cdr
        offered_qos_profiles: {qos}
      message_count: {messages}",
                qos = quoted(QOS_PROFILES)
            );
        }
        let topics = if topics.is_empty() { " []" } else { &topics };
        format!(
            "\
rosbag2_bagfile_information:
  version: 5
  storage_identifier: mcap
  duration:
    nanoseconds: {duration}
  starting_time:
    nanoseconds_since_epoch: {start}
  message_count: {messages}
  topics_with_message_count:{topics}
  compression_format: \"\"
  compression_mode: \"\"
  relative_file_paths:
    - {file}
  files:
    - path: {file}
      starting_time:
        nanoseconds_since_epoch: {start}
      duration:
        nanoseconds: {duration}
      message_count: {messages}
",
            file = quoted(file)
        )
    }
}

/// As a string of JSON, which YAML reads as well.
fn quoted(text: &str) -> String {
    serde_json::Value::from(text).to_string()
}
