//! Frames as JSON objects that readers of logs plot by their keys, with a JSON Schema for each message; and back to the same bytes.
//!
//! # Model
//! ```text
//! object = { "_version": 1 | 2, "_sequence": n, FIELD: value, .. , "_frame": hex }
//! value  = number, null for NaN | array of them | text up to the first NUL
//! ```
//! `_frame` is there only when the values do not give the frame again: it is signed, has infinite numbers, NaN of other bits, text behind a NUL,
//! zeros that need not be sent, or one of the few numbers with all digits that serde_json reads as their neighbours. Then it holds the whole frame.

use std::fmt::Write as _;

use posebridge_telemetry::Address;
use serde_json::{Map, Value as Json, json};

use super::definitions::{FieldDefinition, MessageDefinition, Scalar};
use super::fields::{FullPayload, Value, frame, is_reproduced};
use crate::framing::{FrameRef, VerifiedFrame, WireVersion, verify};

/// Why an object gives no frame.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MessageJsonError {
    #[error("no JSON object")]
    Syntax(#[source] serde_json::Error),
    #[error("`{key}` is {found}: {expected}")]
    Value { key: String, found: String, expected: String },
}

/// The JSON object of a verified frame, which is one of this message.
pub fn write_json(definition: &MessageDefinition, frame: &FrameRef<'_>) -> String {
    let payload = FullPayload::new(frame.payload);
    let version = match frame.version {
        WireVersion::V1 => 1,
        WireVersion::V2 => 2,
    };
    let mut out = format!("{{\"_version\":{version},\"_sequence\":{}", frame.sequence);
    let mut is_exact = is_reproduced(definition, frame, &payload);
    for field in &definition.fields {
        // Writing to a String cannot fail.
        let _ = write!(out, ",\"{}\":", field.name);
        let is_array = field.array.is_some() && !field.is_text();
        if is_array {
            out.push('[');
        }
        for (index, value) in payload.values(field).enumerate() {
            if index > 0 {
                out.push(',');
            }
            is_exact &= write_value(&mut out, value);
        }
        if is_array {
            out.push(']');
        }
    }
    if !is_exact {
        out.push_str(",\"_frame\":\"");
        for byte in frame.raw {
            let _ = write!(out, "{byte:02x}");
        }
        out.push('"');
    }
    out.push('}');
    out
}

/// Whether [`read_json`] gives the value again.
fn write_value(out: &mut String, value: Value<'_>) -> bool {
    let start = out.len();
    match value {
        Value::Unsigned(_) | Value::Signed(_) => {
            value.append_to(out);
            true
        }
        Value::Single(number) if number.is_finite() => {
            value.append_to(out);
            // serde_json reads some numbers as their neighbours.
            serde_json::from_str(&out[start..]).is_ok_and(|read: f64| (read as f32).to_bits() == number.to_bits())
        }
        Value::Double(number) if number.is_finite() => {
            value.append_to(out);
            serde_json::from_str(&out[start..]).is_ok_and(|read: f64| read.to_bits() == number.to_bits())
        }
        Value::Single(number) => {
            out.push_str("null");
            number.to_bits() == f32::NAN.to_bits()
        }
        Value::Double(number) => {
            out.push_str("null");
            number.to_bits() == f64::NAN.to_bits()
        }
        Value::Text(bytes) => {
            let end = bytes.iter().position(|byte| *byte == 0).unwrap_or(bytes.len());
            let text = String::from_utf8_lossy(&bytes[..end]);
            out.push_str(&Json::from(text.as_ref()).to_string());
            text.as_bytes() == &bytes[..end] && bytes[end..].iter().all(|byte| *byte == 0)
        }
    }
}

/// The JSON Schema of a message's objects; units are in the descriptions.
pub fn schema(definition: &MessageDefinition) -> String {
    let mut properties = Map::new();
    properties.insert("_version".to_owned(), json!({"type": "integer", "description": "MAVLink version of the frame"}));
    properties
        .insert("_sequence".to_owned(), json!({"type": "integer", "description": "sequence number of the frame"}));
    let frame = json!({"type": "string", "description": "the whole frame in hexadecimal, where the fields do not give it again"});
    properties.insert("_frame".to_owned(), frame);
    for field in &definition.fields {
        let kind = match field.scalar {
            Scalar::Char => "string",
            // NaN and the infinities are null.
            Scalar::F32 | Scalar::F64 => "number",
            Scalar::U8
            | Scalar::U16
            | Scalar::U32
            | Scalar::U64
            | Scalar::I8
            | Scalar::I16
            | Scalar::I32
            | Scalar::I64 => "integer",
        };
        let mut property = if field.array.is_some() && !field.is_text() {
            json!({"type": "array", "items": {"type": kind}})
        } else {
            json!({"type": kind})
        };
        if let (Some(unit), Some(property)) = (field.unit, property.as_object_mut()) {
            property.insert("description".to_owned(), format!("[{unit}]").into());
        }
        properties.insert(field.name.to_owned(), property);
    }
    json!({
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": definition.name,
        "type": "object",
        "properties": properties,
    })
    .to_string()
}

/// The frame of an object that [`write_json`] wrote, or that somebody changed: by `_frame` where it is there, else by the fields. A field that
/// is missing is zero.
///
/// # Errors
/// It is no such object, or a value does not fit its field.
pub fn read_json(definition: &MessageDefinition, source: Address, text: &[u8]) -> Result<Vec<u8>, MessageJsonError> {
    let object: Map<String, Json> = serde_json::from_slice(text).map_err(MessageJsonError::Syntax)?;
    if let Some(whole) = object.get("_frame") {
        let expected = "a frame of this message and sender in hexadecimal";
        return whole
            .as_str()
            .and_then(|text| frame_of_hex(text, definition.id, source))
            .ok_or_else(|| refusal("_frame", whole, expected));
    }
    let version = match object.get("_version").map(|version| (version, version.as_u64())) {
        None | Some((_, Some(2))) => WireVersion::V2,
        Some((_, Some(1))) => WireVersion::V1,
        Some((version, _)) => return Err(refusal("_version", version, "1 or 2")),
    };
    let sequence = match object.get("_sequence") {
        None => 0,
        Some(number) => number
            .as_u64()
            .and_then(|number| u8::try_from(number).ok())
            .ok_or_else(|| refusal("_sequence", number, "a number from 0 to 255"))?,
    };
    let is_key =
        |key: &str| ["_version", "_sequence"].contains(&key) || definition.fields.iter().any(|field| field.name == key);
    if let Some((key, value)) = object.iter().find(|(key, _)| !is_key(key)) {
        return Err(refusal(key, value, &format!("{} has no such field", definition.name)));
    }
    let mut payload = FullPayload::new(&[]);
    for field in &definition.fields {
        let Some(value) = object.get(field.name) else { continue };
        let is_array = field.array.is_some() && !field.is_text();
        let is_set = match value.as_array() {
            Some(elements) if is_array => {
                elements.iter().enumerate().all(|(index, element)| set(&mut payload, field, index, element))
            }
            Some(_) => false,
            None => !is_array && set(&mut payload, field, 0, value),
        };
        if !is_set {
            let array = field.array.map_or_else(String::new, |length| format!(", at most {length} of it"));
            return Err(refusal(field.name, value, &format!("{:?} is expected{array}", field.scalar)));
        }
    }
    frame(definition, version, source, sequence, &payload)
        .ok_or_else(|| refusal("_version", &Json::from(1), "2 for an id above 255"))
}

fn set(payload: &mut FullPayload, field: &FieldDefinition, index: usize, value: &Json) -> bool {
    let value = match field.scalar {
        Scalar::Char => value.as_str().map(|text| Value::Text(text.as_bytes())),
        Scalar::U8 | Scalar::U16 | Scalar::U32 | Scalar::U64 => value.as_u64().map(Value::Unsigned),
        Scalar::I8 | Scalar::I16 | Scalar::I32 | Scalar::I64 => value.as_i64().map(Value::Signed),
        Scalar::F32 if value.is_null() => Some(Value::Single(f32::NAN)),
        Scalar::F64 if value.is_null() => Some(Value::Double(f64::NAN)),
        Scalar::F32 => value.as_f64().map(|number| Value::Single(number as f32)),
        Scalar::F64 => value.as_f64().map(Value::Double),
    };
    value.is_some_and(|value| payload.set(field, index, value))
}

fn frame_of_hex(text: &str, message_id: u32, source: Address) -> Option<Vec<u8>> {
    let digits: Option<Vec<u8>> = text.chars().map(|digit| digit.to_digit(16).map(|digit| digit as u8)).collect();
    let frame: Vec<u8> = digits?.chunks(2).map(|pair| pair.iter().fold(0, |byte, digit| byte << 4 | digit)).collect();
    let is_whole = text.len() == 2 * frame.len();
    let is_expected = matches!(verify(&frame), VerifiedFrame::Frame(found) if found.message_id == message_id && found.source == source);
    (is_whole && is_expected).then_some(frame)
}

fn refusal(key: &str, found: &Json, expected: &str) -> MessageJsonError {
    let mut found = found.to_string();
    if found.len() > 80 {
        found = found.chars().take(80).chain("..".chars()).collect();
    }
    MessageJsonError::Value { key: key.to_owned(), found, expected: expected.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::super::definition;
    use super::super::definitions::definitions;
    use super::*;
    use crate::framing::parse_verified;

    const SOURCE: Address = Address::new(7, 9);

    #[test]
    fn every_payload_of_every_message_and_length_comes_back() {
        for definition in definitions() {
            for length in 1..=usize::from(definition.fields.iter().map(FieldDefinition::size).sum::<usize>() as u8) {
                // Numbers of all kinds, text that is none, and what follows NULs.
                let bytes: Vec<u8> = (0..length).map(|at| (at * at * 31 + length) as u8 % 251).collect();
                let payload = FullPayload::new(&bytes);
                for version in [WireVersion::V1, WireVersion::V2] {
                    if version == WireVersion::V1 && definition.id > 0xFF {
                        continue;
                    }
                    let sent = frame(definition, version, SOURCE, 200, &payload).unwrap();
                    let text = write_json(definition, &parse_verified(&sent).unwrap());
                    let back = read_json(definition, SOURCE, text.as_bytes()).unwrap();
                    assert_eq!(back, sent, "{} of {length} bytes: {text}", definition.name);
                }
            }
        }
    }

    #[test]
    fn values_that_do_not_fit_are_refused_with_their_key() {
        let status = definition(1).unwrap();
        let as_whole = |message, source| {
            let frame =
                frame(definition(message).unwrap(), WireVersion::V2, source, 0, &FullPayload::new(&[])).unwrap();
            let digits = frame.iter().map(|byte| format!("{byte:02x}")).collect::<Vec<_>>().concat();
            format!("{{\"_frame\": \"{digits}\"}}")
        };
        assert!(read_json(status, SOURCE, as_whole(1, SOURCE).as_bytes()).is_ok());
        let (heartbeat, status_of_another) = (as_whole(0, SOURCE), as_whole(1, Address::new(7, 10)));
        for (text, key) in [
            (r#"{"load": 65536}"#, "`load` is 65536"),
            (r#"{"load": [1]}"#, "`load` is [1]"),
            (r#"{"laod": 1}"#, "SYS_STATUS has no such field"),
            (r#"{"_version": 3}"#, "_version"),
            (r#"{"_sequence": 256}"#, "_sequence"),
            (r#"{"_frame": "fe00"}"#, "_frame"),
            (&heartbeat, "a frame of this message and sender"),
            (&status_of_another, "a frame of this message and sender"),
            ("[1]", "no JSON object"),
        ] {
            let error = read_json(status, SOURCE, text.as_bytes()).unwrap_err().to_string();
            assert!(error.contains(key), "{text}: {error}");
        }
    }

    #[test]
    fn nan_is_null_and_text_ends_at_its_first_nul() {
        let value = definition(22).unwrap();
        let text = br#"{"param_id": "SPEED", "param_value": null}"#;
        let sent = read_json(value, SOURCE, text).unwrap();
        let read = parse_verified(&sent).unwrap();
        assert_eq!(read.payload[..4], f32::NAN.to_le_bytes());
        assert!(
            write_json(value, &read)
                .contains(r#""param_value":null,"param_count":0,"param_index":0,"param_id":"SPEED""#)
        );
    }
}
