//! The files by which a vehicle describes itself to ground stations: what there is to know of it, and its parameters.
//!
//! Source: MAVLink guide, "Component Metadata Protocol"; general.schema.json and parameter.schema.json, version 1, of the MAVLink project.

use std::fmt::Write as _;

use posebridge_estimator::{PARAMS, Param};
use posebridge_protocol::session::{ServedFile, crc32};

/// Where COMPONENT_METADATA says that the description is.
pub(crate) const GENERAL_URI: &str = "mftp:///general.json";

/// COMP_METADATA_TYPE_PARAMETER.
const PARAMETER_TYPE: u8 = 1;

/// Digits behind the decimal point that ground stations show: those of the finest default.
const DECIMAL_PLACES: u8 = 6;

pub(crate) fn metadata_files() -> Vec<ServedFile> {
    let parameters = parameter_file().into_bytes();
    let general = general_file(&parameters).into_bytes();
    vec![
        ServedFile { name: "general.json", content: general },
        ServedFile { name: "parameter.json", content: parameters },
    ]
}

/// The checksum of the general file, by which a ground station knows whether the one that it keeps is still right.
pub(crate) fn general_crc() -> u32 {
    crc32(0, general_file(parameter_file().as_bytes()).as_bytes())
}

fn general_file(parameters: &[u8]) -> String {
    let crc = crc32(0, parameters);
    format!(
        "{{\"version\":1,\"metadataTypes\":[{{\"type\":{PARAMETER_TYPE},\"uri\":\"mftp:///parameter.json\",\"fileCrc\":{crc}}}]}}"
    )
}

fn parameter_file() -> String {
    let rows: Vec<String> = PARAMS.iter().map(parameter_row).collect();
    format!("{{\"version\":1,\"parameters\":[{}]}}", rows.join(","))
}

fn parameter_row(row: &Param) -> String {
    let (low, high) = (row.range.start(), row.range.end());
    format!(
        "{{\"name\":{},\"type\":\"Float\",\"group\":\"Filter\",\"shortDesc\":{},\"units\":{},\"min\":{low},\"max\":{high},\
         \"default\":{},\"decimalPlaces\":{DECIMAL_PLACES}}}",
        quoted(&row.key.to_ascii_uppercase()),
        quoted(row.doc),
        quoted(row.unit),
        row.default,
    )
}

/// A string of JSON.
fn quoted(text: &str) -> String {
    let mut quoted = String::from('"');
    for character in text.chars() {
        match character {
            '"' | '\\' => quoted.extend(['\\', character]),
            control if control.is_control() => {
                let _ = write!(quoted, "\\u{:04x}", u32::from(control));
            }
            other => quoted.push(other),
        }
    }
    quoted.push('"');
    quoted
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_json_cannot_hold_is_escaped() {
        assert_eq!(quoted("a \"b\" \\ \n\u{e9}"), "\"a \\\"b\\\" \\\\ \\u000a\u{e9}\"");
    }

    #[test]
    fn the_general_file_names_the_parameters_with_their_checksum() {
        let files = metadata_files();
        let text = String::from_utf8(files[0].content.clone()).unwrap();
        assert!(text.contains(&format!("\"fileCrc\":{}", crc32(0, &files[1].content))), "{text}");
        assert_eq!(general_crc(), crc32(0, &files[0].content));
        // The address of a field with its zero.
        assert!(GENERAL_URI.len() < 100);
    }
}
