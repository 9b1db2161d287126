//! `posebridge export --messages` and its way back, over logs that foreign programs have written and decoded.

use std::collections::BTreeMap;
use std::io::Read;
use std::path::{Path, PathBuf};

use crate::support::{exit_code_and_stderr, root, run, shared_data};
use flate2::read::MultiGzDecoder;
use posebridge_protocol::dialect::definition;
use posebridge_protocol::dialect::definitions::Scalar;
use posebridge_protocol::dialect::message_name;
use posebridge_protocol::framing::{VerifiedFrame, verify};
use posebridge_recording::tlog::{FrameCheck, TlogReader, TlogRecord};
use serde_json::Value;

fn unpacked(path: &Path) -> Vec<u8> {
    let bytes = std::fs::read(path).unwrap();
    if !bytes.starts_with(&[0x1F, 0x8B]) {
        return bytes;
    }
    let mut plain = Vec::new();
    MultiGzDecoder::new(bytes.as_slice()).read_to_end(&mut plain).unwrap();
    plain
}

/// Times and frames that can be verified.
fn records(path: &Path) -> Vec<(u64, Vec<u8>)> {
    let check = &mut |raw: &[u8]| match verify(raw) {
        VerifiedFrame::Frame(_) => FrameCheck::Valid(()),
        VerifiedFrame::UnknownFrame(_) => FrameCheck::Unknown(()),
        VerifiedFrame::Invalid => FrameCheck::Invalid,
    };
    let mut found = Vec::new();
    let take = &mut |record: TlogRecord<'_, ()>| {
        if record.check == FrameCheck::Valid(()) {
            found.push((record.micros, record.frame.to_vec()));
        }
    };
    let mut reader = TlogReader::new();
    reader.push(&unpacked(path), check, take);
    reader.finish(check, take);
    found
}

fn logs() -> Vec<PathBuf> {
    let mut logs = vec![root().join("tests/data/tlog/mixed.tlog")];
    if let Some(data) = shared_data() {
        for name in ["rover_cubeblack.tlog", "crawler_esp32_short.tlog", "copter_apm_v1_2013.tlog.gz"] {
            logs.push(data.join("mavlink").join(name));
        }
    }
    logs
}

fn inspected(folder: &Path, file: &str) -> Value {
    serde_json::from_str(&run(folder, &["inspect", file, "--json"])).unwrap()
}

/// How many frames of which message came from whom.
fn counts(inspected: &Value) -> BTreeMap<String, u64> {
    let sources = inspected["sources"].as_array().unwrap().iter();
    let messages = sources.flat_map(|source| {
        let messages = source["messages"].as_array().unwrap().iter();
        messages.map(|one| {
            let key = format!("{}/{} {}", source["system"], source["component"], one["name"]);
            (key, one["frames"].as_u64().unwrap())
        })
    });
    messages.collect()
}

#[test]
fn messages_in_mcap_become_the_same_frames_again() {
    for log in logs() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        run(folder, &["export", log.to_str().unwrap(), "--messages", "--format", "mcap", "--out", "out"]);
        let name = log.file_name().unwrap().to_str().unwrap().split('.').next().unwrap();
        let messages = format!("out/{name}-messages.mcap");
        run(folder, &["import", &messages, "--out", "again.tlog"]);
        let [of_log, of_messages] = [log.to_str().unwrap(), &messages].map(|file| inspected(folder, file));
        assert_eq!(of_messages["kind"], "messages");
        for key in ["frames", "versions", "signed_frames", "first_utc_micros"] {
            assert_eq!(of_messages[key], of_log[key], "{key} of {name}");
        }
        assert_eq!(counts(&of_messages), counts(&of_log), "{name}");
        let (_, stderr) = exit_code_and_stderr(folder, &["replay", &messages]);
        assert!(stderr.contains("posebridge import FILE --out LOG.tlog"), "{stderr}");
        let (before, after) = (records(&log), records(&folder.join("again.tlog")));
        assert_eq!(before.len(), after.len(), "{name}");
        let mut latest = 0;
        for (before, after) in before.iter().zip(&after) {
            assert_eq!(before.1, after.1, "{name}");
            // Times in a log that we write never step back.
            latest = before.0.max(latest);
            assert_eq!(latest, after.0, "{name}");
        }
    }
}

#[test]
fn a_log_of_messages_that_is_cut_is_read_up_to_there() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let log = root().join("tests/data/tlog/mixed.tlog");
    run(folder, &["export", log.to_str().unwrap(), "--messages", "--format", "mcap"]);
    let whole = std::fs::read(folder.join("mixed-messages.mcap")).unwrap();
    let frames = records(&log).len();
    // In the last chunk, and in the first.
    let mut counts = Vec::new();
    for length in [whole.len() - 20, whole.len() / 2] {
        std::fs::write(folder.join("cut.mcap"), &whole[..length]).unwrap();
        let out = format!("{length}.tlog");
        let (code, stderr) = exit_code_and_stderr(folder, &["import", "cut.mcap", "--out", &out]);
        assert!(code == Some(0) && stderr.contains("the file is cut off here"), "{stderr}");
        counts.push(records(&folder.join(&out)).len());
    }
    assert_eq!(counts[0], frames, "what is missing is the summary");
    assert!(0 < counts[1] && counts[1] < frames, "{counts:?}");
}

/// Rows of a table by column without its unit, in the order of the file.
fn table(path: &Path) -> Vec<BTreeMap<String, String>> {
    let mut reader = csv::Reader::from_path(path).unwrap();
    let names: Vec<String> =
        reader.headers().unwrap().iter().map(|name| name.split(' ').next().unwrap().to_owned()).collect();
    let row = |record: csv::StringRecord| names.iter().cloned().zip(record.iter().map(str::to_owned)).collect();
    reader.records().map(|record| row(record.unwrap())).collect()
}

fn assert_agrees(what: &str, scalar: Option<Scalar>, ours: &str, theirs: &Value) {
    let agrees = match theirs {
        // JSON has neither.
        Value::Null => ["NaN", "inf", "-inf"].contains(&ours),
        Value::String(text) => ours == text,
        // Their oracle has the decimals of a double.
        Value::Number(number) if scalar == Some(Scalar::F32) => {
            ours.parse::<f32>() == Ok(number.as_f64().unwrap() as f32)
        }
        Value::Number(number) if scalar == Some(Scalar::F64) => ours.parse::<f64>() == Ok(number.as_f64().unwrap()),
        number => *ours == *number.to_string(),
    };
    assert!(agrees, "{what}: {ours}, and by pymavlink {theirs}");
}

#[test]
fn every_field_is_what_pymavlink_decoded() {
    let Some(data) = shared_data() else { return };
    let mut compared = 0;
    for name in ["rover_cubeblack.tlog", "crawler_esp32_short.tlog", "copter_apm_v1_2013.tlog.gz"] {
        let folder = tempfile::tempdir().unwrap();
        let log = data.join("mavlink").join(name);
        run(folder.path(), &["export", log.to_str().unwrap(), "--messages", "--format", "csv"]);
        let stem = name.split('.').next().unwrap();
        let tables = folder.path().join(format!("{stem}-messages"));
        let mut rows: BTreeMap<u64, std::vec::IntoIter<BTreeMap<String, String>>> = BTreeMap::new();
        let decoded = unpacked(&data.join("mavlink").join(format!("{stem}.tlog.decoded.jsonl.gz")));
        for line in String::from_utf8(decoded).unwrap().lines() {
            let theirs: serde_json::Map<String, Value> = serde_json::from_str(line).unwrap();
            let id = theirs["_msgid"].as_u64().unwrap();
            let kind = message_name(id as u32).unwrap();
            let rows = rows.entry(id).or_insert_with(|| table(&tables.join(format!("{kind}.csv"))).into_iter());
            let ours = rows.next().unwrap();
            for (key, theirs) in &theirs {
                let key = match key.as_str() {
                    "_ts_us" => "_time",
                    "_sys" => "_system",
                    "_comp" => "_component",
                    "_seq" => "_sequence",
                    "_ver" | "_msgid" | "mavpackettype" => continue,
                    key => key,
                };
                let fields = &definition(id as u32).unwrap().fields;
                let scalar = fields.iter().find(|field| field.name == key).map(|field| field.scalar);
                if let Value::Array(elements) = theirs {
                    for (index, element) in elements.iter().enumerate() {
                        let key = format!("{key}[{index}]");
                        assert_agrees(&format!("{kind}.{key}"), scalar, &ours[&key], element);
                        compared += 1;
                    }
                } else {
                    assert_agrees(&format!("{kind}.{key}"), scalar, &ours[key], theirs);
                    compared += 1;
                }
            }
        }
        assert!(rows.values().all(|rows| rows.len() == 0), "{name}: rows that pymavlink has not");
    }
    assert!(compared > 300_000, "{compared}");
}

#[test]
fn what_cannot_be_decoded_is_refused_with_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    std::fs::write(folder.join("a.raw"), [0xFD, 9, 0, 0, 0, 1, 1, 0, 0, 0, 0, 0, 0, 0, 10, 0, 0, 4, 3, 0xDE, 0xEB])
        .unwrap();
    run(folder, &["export", "a.raw", "--messages", "--format", "csv"]);
    let rows = table(&folder.join("a-messages/HEARTBEAT.csv"));
    assert_eq!((rows[0]["_time"].as_str(), rows[0]["type"].as_str()), ("", "10"));
    for (arguments, said) in [
        (&["export", "a.raw", "--messages", "--format", "mcap"][..], "has no times"),
        (&["export", "a.raw", "--messages", "--format", "tum"], "--messages writes --format csv and mcap"),
        (&["export", "a.raw", "--messages", "--format", "csv", "--smooth"], "leave out"),
    ] {
        let (code, stderr) = exit_code_and_stderr(folder, arguments);
        assert!(code != Some(0) && stderr.contains(said), "{stderr}");
    }
}
