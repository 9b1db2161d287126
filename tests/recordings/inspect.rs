//! `posebridge inspect` over files that foreign programs have written and counted.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use crate::support::{OPTIODOM_RUN, committed_data, descriptor, json, posebridge, root, run, shared_data};
use rand::{Rng, SeedableRng};
use serde_json::Value;

/// Its object; the exit code says whether anything was found.
fn inspect(file: &Path) -> Value {
    let mut command = posebridge(file.parent().unwrap());
    let output = command.args(["inspect", file.file_name().unwrap().to_str().unwrap(), "--json"]).output().unwrap();
    let found: Value = serde_json::from_slice(&output.stdout).unwrap();
    let is_empty = found["frames"] == 0 && found["unknown_frames"] == 0;
    assert_eq!(output.status.code(), Some(i32::from(is_empty)), "{}", file.display());
    found
}

/// The captures of a folder with what another decoder counted in each.
fn collection(folder: &Path) -> Vec<(PathBuf, Value)> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.to_string_lossy().ends_with(".expected.json") {
            let expected: Value = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
            let name = expected["file"].as_str().unwrap();
            let plain = folder.join(name);
            let packed = folder.join(format!("{name}.gz"));
            found.push((if plain.exists() { plain } else { packed }, expected));
        }
    }
    found
}

/// Frames by the texts that `key` makes of the entries of a list.
fn frames_by(list: &Value, key: impl Fn(&Value) -> String) -> BTreeMap<String, u64> {
    let entries = list.as_array().unwrap().iter();
    entries.map(|entry| (key(entry), entry["frames"].as_u64().unwrap())).collect()
}

fn address(source: &Value) -> String {
    format!("{}/{}", source["system"], source["component"])
}

fn counts(of: &Value) -> BTreeMap<String, u64> {
    serde_json::from_value(of.clone()).unwrap()
}

/// Senders that do not count by one have absurd losses by plain summing; those are only required to be capped.
const ABSURD: u64 = 1_000;

fn compare(file: &Path, expected: &Value) {
    let found = inspect(file);
    let name = file.display();
    for (ours, theirs) in [
        ("bytes", "bytes"),
        ("frames", "valid_frames"),
        ("bytes_outside", "bytes_outside_valid_frames"),
        ("versions", "by_version"),
    ] {
        assert_eq!(found[ours], expected[theirs], "{name}: {ours}");
    }
    if expected.get("first_ts_us").is_some() {
        assert_eq!(found["first_utc_micros"], expected["first_ts_us"], "{name}");
        assert_eq!(found["last_utc_micros"], expected["last_ts_us"], "{name}");
        assert_eq!(found["times_backwards"], expected["non_monotonic_ts"], "{name}");
    }
    let by_source = frames_by(&found["sources"], address);
    assert_eq!(by_source, counts(&expected["by_source"]), "{name}");
    let by_message = frames_by(&found["messages"], |message| message["name"].as_str().unwrap().to_owned());
    assert_eq!(by_message, counts(&expected["by_message"]), "{name}");
    let Some(missing) = expected.get("seq_missing_by_source") else {
        return;
    };
    for source in found["sources"].as_array().unwrap() {
        let Some(expected) = missing.get(address(source)).and_then(Value::as_u64) else {
            continue;
        };
        let lost = source["lost"].as_u64().unwrap();
        assert_eq!(source["sequence_steps"], expected, "{name}: {source}");
        assert!(lost == expected || (expected >= ABSURD && lost < expected), "{name}: {source}");
    }
}

#[test]
fn files_count_as_foreign_writers_and_decoders_count() {
    for (file, expected) in collection(&root().join("tests/data/tlog")) {
        compare(&file, &expected);
        let found = inspect(&file);
        assert_eq!((&found["kind"], &found["tlog"]["byte_order"]), (&"tlog".into(), &"big".into()));
    }
    let Some(data) = shared_data() else { return };
    let files = collection(&data.join("mavlink"));
    assert!(files.len() >= 6, "only {} files", files.len());
    for (file, expected) in files {
        compare(&file, &expected);
    }
}

#[test]
fn noise_of_any_kind_holds_no_frame_and_breaks_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let mut random = rand_pcg::Pcg64::seed_from_u64(7);
    let mut noise = vec![0; 200_000];
    random.fill_bytes(&mut noise);
    let starts: Vec<u8> = noise.iter().map(|byte| 0xFD + byte % 2).collect();
    for (name, bytes) in [
        ("noise.bin", &noise[..]),
        ("noise.tlog", &noise),
        ("starts.raw", &starts),
        ("starts.tlog", &starts),
        ("empty.tlog", &[]),
        ("short.bin", &noise[..3]),
    ] {
        let file = folder.path().join(name);
        std::fs::write(&file, bytes).unwrap();
        let found = inspect(&file);
        assert_eq!(found["frames"], 0, "{name}");
        assert_eq!(found["bytes_outside"], bytes.len(), "{name}");
    }
}

#[test]
fn a_log_with_times_the_wrong_way_round_is_read_and_told() {
    let folder = tempfile::tempdir().unwrap();
    let original = std::fs::read(root().join("tests/data/tlog/mixed.tlog")).unwrap();
    let mut swapped = original[..8 + 28 + 12].to_vec();
    swapped[..8].reverse();
    let file = folder.path().join("swapped.tlog");
    std::fs::write(&file, swapped).unwrap();
    let found = inspect(&file);
    assert_eq!(found["frames"], 1);
    assert_eq!(found["first_utc_micros"], 1_700_000_000_000_000_u64);
    assert_eq!(found["tlog"]["byte_order"], "little");
    let printed = run(folder.path(), &["inspect", "swapped.tlog"]);
    assert!(printed.contains("little-endian"), "{printed}");
}

#[test]
fn a_descriptor_is_inspected_by_kind_of_observation() {
    let folder = tempfile::tempdir().unwrap();
    let args = ["inspect", &descriptor("optiodom.toml"), "--data", &committed_data(), "--run", OPTIODOM_RUN];
    let found = json(folder.path(), &args);
    let run = &found["runs"][0];
    assert_eq!(run["name"], OPTIODOM_RUN);
    assert!(run["truth"].as_u64().unwrap() > 100);
    assert!(run["observations"][0]["rate_hz"].as_f64().unwrap() > 1.0);
}
