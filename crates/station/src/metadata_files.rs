//! The files by which a vehicle describes itself to ground stations: what there is to know of it, and its parameters.
//!
//! Source: MAVLink guide, "Component Metadata Protocol"; general.schema.json and parameter.schema.json, version 1, of the MAVLink project.

use std::sync::LazyLock;

use posebridge_estimator::{PARAMS, Param};
use posebridge_protocol::session::{ServedFile, crc32};
use serde_json::{Value, json};

/// Where COMPONENT_METADATA says that the description is.
pub(crate) const GENERAL_URI: &str = "mftp:///general.json";

/// COMP_METADATA_TYPE_PARAMETER.
const PARAMETER_TYPE: u8 = 1;

/// Digits behind the decimal point that ground stations show: those of the finest default.
const DECIMAL_PLACES: u8 = 6;

/// The checksum of the general file, by which a ground station knows whether the one that it keeps is still right.
static GENERAL_CRC: LazyLock<u32> =
    LazyLock::new(|| crc32(0, general_file(parameter_file().to_string().as_bytes()).to_string().as_bytes()));

pub(crate) fn metadata_files() -> Vec<ServedFile> {
    let parameters = parameter_file().to_string().into_bytes();
    let general = general_file(&parameters).to_string().into_bytes();
    vec![
        ServedFile { name: "general.json", content: general },
        ServedFile { name: "parameter.json", content: parameters },
    ]
}

pub(crate) fn general_crc() -> u32 {
    *GENERAL_CRC
}

fn general_file(parameters: &[u8]) -> Value {
    let parameters = json!({"type": PARAMETER_TYPE, "uri": "mftp:///parameter.json", "fileCrc": crc32(0, parameters)});
    json!({"version": 1, "metadataTypes": [parameters]})
}

fn parameter_file() -> Value {
    json!({"version": 1, "parameters": PARAMS.iter().map(parameter_row).collect::<Vec<_>>()})
}

fn parameter_row(row: &Param) -> Value {
    json!({
        "name": row.key.to_ascii_uppercase(),
        "type": "Float",
        "group": "Filter",
        "shortDesc": row.doc,
        "units": row.unit,
        "min": row.range.start(),
        "max": row.range.end(),
        "default": row.default,
        "decimalPlaces": DECIMAL_PLACES,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_general_file_names_the_parameters_with_their_checksum() {
        let files = metadata_files();
        let general: Value = serde_json::from_slice(&files[0].content).unwrap();
        assert_eq!(general["metadataTypes"][0]["fileCrc"], crc32(0, &files[1].content));
        assert_eq!(general_crc(), crc32(0, &files[0].content));
    }
}
