//! A frame as a line of its message's table, in CSV (RFC 4180): what the caller knows of it, then a value for each of [`super::fields::columns`].

use super::definitions::MessageDefinition;
use super::fields::{FullPayload, Value};
use super::payload::text_from;

/// One line after another, in the same memory.
#[derive(Debug, Default)]
pub struct CsvLine {
    text: String,
}

impl CsvLine {
    /// A value before those of the message; `None` leaves its column empty.
    pub fn push(&mut self, value: Option<u64>) {
        if let Some(value) = value {
            Value::Unsigned(value).append_to(&mut self.text);
        }
        self.text.push(',');
    }

    /// The values of all columns of a message. Text stands in double quotes.
    pub fn push_payload(&mut self, definition: &MessageDefinition, payload: &FullPayload) {
        for field in &definition.fields {
            for value in payload.values(field) {
                if let Value::Text(bytes) = value {
                    self.text.push('"');
                    self.text.push_str(&text_from(bytes).replace('"', "\"\""));
                    self.text.push('"');
                } else {
                    value.append_to(&mut self.text);
                }
                self.text.push(',');
            }
        }
    }

    /// Ends the line and passes it on; the next one is empty.
    pub fn finish<T>(&mut self, write: impl FnOnce(&[u8]) -> T) -> T {
        // The comma behind the last value.
        self.text.pop();
        self.text.push('\n');
        let written = write(self.text.as_bytes());
        self.text.clear();
        written
    }
}

#[cfg(test)]
mod tests {
    use super::super::definitions::definition;
    use super::*;

    fn line(id: u32, payload: &[u8]) -> String {
        let mut line = CsvLine::default();
        line.push(None);
        line.push(Some(7));
        line.push_payload(definition(id).unwrap(), &FullPayload::new(payload));
        line.finish(|bytes| String::from_utf8(bytes.to_vec()).unwrap())
    }

    #[test]
    fn text_is_quoted_and_ends_at_its_nul() {
        // STATUSTEXT: severity, text of 50 characters, id, chunk_seq.
        assert_eq!(line(253, b"\x04say \"yes, no\"\0more"), ",7,4,\"say \"\"yes, no\"\"\",0,0\n");
    }

    #[test]
    fn numbers_have_the_digits_that_read_as_them() {
        // ATTITUDE: time_boot_ms, then six floats.
        let floats = [0.1_f32, -0.0, f32::MIN_POSITIVE, 1e20, f32::NAN, f32::NEG_INFINITY];
        let bytes: Vec<u8> =
            4_000_000_000_u32.to_le_bytes().into_iter().chain(floats.into_iter().flat_map(f32::to_le_bytes)).collect();
        assert_eq!(line(30, &bytes), ",7,4000000000,0.1,-0.0,1.1754944e-38,1e+20,NaN,-inf\n");
    }
}
