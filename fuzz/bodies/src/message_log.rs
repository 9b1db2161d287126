//! Any bytes as a log of JSON messages: reading ends, and what was read can be written and reads again as the same.

use std::collections::BTreeMap;
use std::convert::Infallible;

use posebridge_recording::container::unpack_recording;
use posebridge_recording::json_log::{JsonChannel, JsonLogDamage, JsonLogWriter, read_json_log};

/// Of the unpacked file.
const MAX_BYTES: u64 = 1_000_000;

#[derive(Debug, PartialEq, Eq)]
struct OwnedMessage {
    topic: String,
    metadata: BTreeMap<String, String>,
    log_nanos: u64,
    text: String,
}

/// Input: the file.
pub(crate) fn check(data: &[u8]) {
    let Ok(unpacked) = unpack_recording(data.to_vec(), MAX_BYTES) else {
        return;
    };
    let (messages, _) = read(&unpacked);
    let (again, damage) = read(&written(&messages));
    assert_eq!((again, damage), (messages, JsonLogDamage::default()));
}

/// The messages whose bytes are text.
fn read(file: &[u8]) -> (Vec<OwnedMessage>, JsonLogDamage) {
    let mut messages = Vec::new();
    let Ok(damage) = read_json_log::<Infallible>(file, |message| {
        if let Ok(text) = std::str::from_utf8(message.json) {
            let (topic, metadata) = (message.topic.to_owned(), message.metadata.clone());
            messages.push(OwnedMessage { topic, metadata, log_nanos: message.log_nanos, text: text.to_owned() });
        }
        Ok(())
    });
    (messages, damage)
}

fn written(messages: &[OwnedMessage]) -> Vec<u8> {
    let file = JsonLogWriter::create(Vec::new()).and_then(|mut writer| {
        for OwnedMessage { topic, metadata, log_nanos, text } in messages {
            let channel = JsonChannel { topic: topic.clone(), metadata: metadata.clone(), ..JsonChannel::default() };
            let channel = writer.add_channel(&channel)?;
            writer.write(channel, *log_nanos, 0, text)?;
        }
        writer.finish()
    });
    match file {
        Ok(file) => file,
        Err(error) => panic!("a vector takes everything: {error}"),
    }
}
