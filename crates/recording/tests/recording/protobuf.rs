//! Reads any protocol buffer by its descriptor; unknown fields are errors.
//!
//! Source: the protocol buffers' "Encoding" page: a key is `number << 3 | wire type`; 0 varint, 1 eight bytes, 2
//! counted bytes, 5 four bytes.

use std::fmt;

use prost_types::field_descriptor_proto::Type;
use prost_types::{DescriptorProto, FileDescriptorSet};

/// The leaves of a message by their path, in the order in which they stand there.
pub(crate) struct DecodedFields(Vec<(String, FieldValue)>);

enum FieldValue {
    Number(f64),
    Text(String),
}

impl DecodedFields {
    pub(crate) fn numbers(&self, path: &str) -> Vec<f64> {
        let of_path = self.0.iter().filter(|(found, _)| found == path);
        of_path
            .map(|(_, leaf)| match leaf {
                FieldValue::Number(number) => *number,
                FieldValue::Text(text) => panic!("{path} is the text {text}"),
            })
            .collect()
    }

    pub(crate) fn text(&self, path: &str) -> String {
        let leaf = self.0.iter().find(|(found, _)| found == path);
        match leaf {
            Some((_, FieldValue::Text(text))) => text.clone(),
            _ => panic!("{path} is no text"),
        }
    }
}

/// Numbers have twelve decimals.
impl fmt::Display for DecodedFields {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let field = |fields: &[(String, FieldValue)]| {
            let values = fields.iter().map(|(_, value)| match value {
                FieldValue::Number(number) => format!("{number:.12}"),
                FieldValue::Text(text) => format!("{text:?}"),
            });
            format!("{}={}", fields[0].0, values.collect::<Vec<_>>().join(","))
        };
        let fields = self.0.chunk_by(|(one, _), (next, _)| one == next).map(field);
        f.write_str(&fields.collect::<Vec<_>>().join(" "))
    }
}

/// Reads the message `name` (with its package) by a serialised `FileDescriptorSet`.
pub(crate) fn read(descriptors: &[u8], name: &str, data: &[u8]) -> DecodedFields {
    let set: FileDescriptorSet = prost::Message::decode(descriptors).unwrap();
    let mut fields = DecodedFields(Vec::new());
    let mut reader = ProtobufReader { set: &set, fields: &mut fields };
    reader.message(&format!(".{name}"), "", data);
    fields
}

struct ProtobufReader<'a> {
    set: &'a FileDescriptorSet,
    fields: &'a mut DecodedFields,
}

impl ProtobufReader<'_> {
    fn descriptor(&self, name: &str) -> &DescriptorProto {
        let found = self.set.file.iter().find_map(|file| {
            let package = format!(".{}.", file.package());
            let short = name.strip_prefix(&package)?;
            file.message_type.iter().find(|one| one.name() == short)
        });
        found.unwrap_or_else(|| panic!("{name} is not described"))
    }

    fn message(&mut self, name: &str, path: &str, mut data: &[u8]) {
        while !data.is_empty() {
            let key = varint(&mut data);
            let (number, wire) = ((key >> 3) as i32, key & 7);
            let described = self.descriptor(name).field.iter();
            let field = described.clone().find(|field| field.number() == number);
            let field = field.unwrap_or_else(|| panic!("{name} has no field {number}")).clone();
            let path = match path {
                "" => field.name().to_owned(),
                _ => format!("{path}.{}", field.name()),
            };
            match (field.r#type(), wire) {
                (Type::Message, 2) => {
                    let body = length_delimited(&mut data);
                    self.message(field.type_name(), &path, body);
                }
                (Type::String, 2) => {
                    let text = std::str::from_utf8(length_delimited(&mut data)).unwrap().to_owned();
                    self.fields.0.push((path, FieldValue::Text(text)));
                }
                (Type::Double, 2) => {
                    let mut packed = length_delimited(&mut data);
                    while !packed.is_empty() {
                        let number = double(&mut packed);
                        self.fields.0.push((path.clone(), FieldValue::Number(number)));
                    }
                }
                (Type::Double, 1) => {
                    let number = double(&mut data);
                    self.fields.0.push((path, FieldValue::Number(number)));
                }
                (Type::Int64 | Type::Int32 | Type::Enum | Type::Bool, 0) => {
                    let number = varint(&mut data) as i64 as f64;
                    self.fields.0.push((path, FieldValue::Number(number)));
                }
                (kind, wire) => panic!("{name}.{path} is {kind:?} and was written as {wire}"),
            }
        }
    }
}

fn varint(data: &mut &[u8]) -> u64 {
    let mut number = 0;
    for shift in (0..64).step_by(7) {
        let (byte, rest) = data.split_first().unwrap();
        *data = rest;
        number |= u64::from(byte & 0x7F) << shift;
        if byte & 0x80 == 0 {
            return number;
        }
    }
    panic!("a number of more than ten bytes")
}

fn length_delimited<'a>(data: &mut &'a [u8]) -> &'a [u8] {
    let length = varint(data) as usize;
    let (bytes, rest) = data.split_at(length);
    *data = rest;
    bytes
}

fn double(data: &mut &[u8]) -> f64 {
    let (bytes, rest) = data.split_first_chunk().unwrap();
    *data = rest;
    f64::from_le_bytes(*bytes)
}
