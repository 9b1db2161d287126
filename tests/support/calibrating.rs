//! RunningProgram `posebridge calibrate`, and reading what it says.

use std::path::Path;

use serde_json::Value;

use crate::support::{posebridge, stdout_of};

/// Runs a way of `calibrate` in a folder and reads its object.
pub(crate) fn calibrate(folder: &Path, args: &[&str]) -> Value {
    let printed = stdout_of(posebridge(folder).arg("calibrate").args(args).arg("--json"));
    serde_json::from_str(&printed).expect("one JSON object")
}

/// Exit code and talk of a command that cannot do what it is asked.
pub(crate) fn calibrate_failing(folder: &Path, args: &[&str]) -> (i32, String) {
    let output = posebridge(folder).arg("calibrate").args(args).output().expect("the program starts");
    assert!(output.stdout.is_empty());
    let said = String::from_utf8(output.stderr).expect("it says text");
    (output.status.code().expect("it ends by itself"), said)
}

/// A number of an object, by its place.
pub(crate) fn number(object: &Value, pointer: &str) -> f64 {
    let value = object.pointer(pointer).and_then(Value::as_f64);
    value.unwrap_or_else(|| panic!("{pointer} in {object}"))
}
