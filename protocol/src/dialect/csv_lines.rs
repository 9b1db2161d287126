//! Frames as lines of their message's table, in CSV (RFC 4180): what the caller knows of a frame, then a value for each of [`super::fields::columns`].

use std::ops::Range;

use super::definitions::{MessageDefinition, Scalar};
use super::fields::{FullPayload, Value, columns, value_of};
use super::payload::text_from;

/// Lines of one table that are not written yet.
///
/// Half of the values of a vehicle are those of its message before. Their text is copied, which takes less time than writing them again.
#[derive(Clone, Debug)]
pub struct CsvLines {
    text: String,
    columns: Vec<Column>,
    /// Of the last line.
    payload: FullPayload,
    /// The values of the last line, a comma behind each; empty before the first.
    values: String,
    /// Memory for the values of the next line.
    spare: String,
}

#[derive(Clone, Debug)]
struct Column {
    scalar: Scalar,
    /// Of the payload.
    bytes: Range<usize>,
    /// Of its value and comma in `values`.
    end: usize,
}

impl CsvLines {
    /// With the header of the table: the names of the values before those of the message, and its own.
    pub fn new(before: &[&str], definition: &MessageDefinition) -> Self {
        let names = before.iter().map(|name| (*name).to_owned()).chain(columns(definition));
        let fields = definition.fields.iter().flat_map(|field| {
            let size = if field.is_text() { field.size() } else { field.scalar.size() };
            let starts = (field.offset..field.offset + field.size()).step_by(size.max(1));
            starts.map(move |start| Column { scalar: field.scalar, bytes: start..start + size, end: 0 })
        });
        Self {
            text: names.collect::<Vec<_>>().join(",") + "\n",
            columns: fields.collect(),
            payload: FullPayload::new(&[]),
            values: String::new(),
            spare: String::new(),
        }
    }

    /// A value before those of the message; `None` leaves its column empty.
    pub fn push(&mut self, value: Option<u64>) {
        if let Some(value) = value {
            Value::Unsigned(value).append_to(&mut self.text);
        }
        self.text.push(',');
    }

    /// The values of all columns of the message, and the end of the line. Text stands in double quotes.
    pub fn push_payload(&mut self, payload: FullPayload) {
        let is_first = self.values.is_empty();
        let (mut line, mut start, mut copied) = (std::mem::take(&mut self.spare), 0, 0);
        for column in &mut self.columns {
            let end = column.end;
            let bytes = payload.bytes(column.bytes.clone());
            if is_first || differ(bytes, self.payload.bytes(column.bytes.clone())) {
                line.push_str(&self.values[copied..start]);
                append_value(&mut line, value_of(column.scalar, bytes));
                column.end = line.len();
                copied = end;
            } else {
                column.end = line.len() + (end - copied);
            }
            start = end;
        }
        line.push_str(&self.values[copied..]);
        self.text.push_str(&line);
        // The comma behind the last value.
        self.text.truncate(self.text.len() - 1);
        self.text.push('\n');
        self.spare = std::mem::replace(&mut self.values, line);
        self.spare.clear();
        self.payload = payload;
    }

    /// All lines since [`Self::clear`].
    pub fn as_bytes(&self) -> &[u8] {
        self.text.as_bytes()
    }

    pub fn clear(&mut self) {
        self.text.clear();
    }
}

/// Of equal length; that of a number is compared at once, without a loop.
fn differ(one: &[u8], other: &[u8]) -> bool {
    match (one, other) {
        ([a], [b]) => a != b,
        ([a0, a1], [b0, b1]) => [a0, a1] != [b0, b1],
        ([a0, a1, a2, a3], [b0, b1, b2, b3]) => [a0, a1, a2, a3] != [b0, b1, b2, b3],
        _ => one != other,
    }
}

fn append_value(line: &mut String, value: Value<'_>) {
    if let Value::Text(bytes) = value {
        line.push('"');
        line.push_str(&text_from(bytes).replace('"', "\"\""));
        line.push('"');
    } else {
        value.append_to(line);
    }
    line.push(',');
}

#[cfg(test)]
mod tests {
    use super::super::definition;
    use super::*;

    fn line(id: u32, payload: &[u8]) -> String {
        let mut lines = CsvLines::new(&[], definition(id).unwrap());
        lines.clear();
        lines.push(None);
        lines.push(Some(7));
        lines.push_payload(FullPayload::new(payload));
        String::from_utf8(lines.as_bytes().to_vec()).unwrap()
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

    #[test]
    fn what_stays_is_written_again() {
        // PARAM_VALUE: value, count, index, name, type.
        let payload = |value: f32, index: u16, name: &[u8; 16]| {
            let whole = [&value.to_le_bytes()[..], &300_u16.to_le_bytes(), &index.to_le_bytes(), name, &[9]].concat();
            FullPayload::new(&whole)
        };
        let mut lines = CsvLines::new(&["_link"], definition(22).unwrap());
        for (value, index, name) in [
            (1.0, 9, b"A\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0"),
            (1.0, 10, b"A\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0"),
            (-0.25, 10, b"LONGER\0\0\0\0\0\0\0\0\0\0"),
            (-0.25, 10, b"LONGER\0\0\0\0\0\0\0\0\0\0"),
            (7.5, 8, b"LONGER\0\0\0\0\0\0\0\0\0\0"),
        ] {
            lines.push(Some(0));
            lines.push_payload(payload(value, index, name));
        }
        let expected = "_link,param_value,param_count,param_index,param_id,param_type\n\
                        0,1.0,300,9,\"A\",9\n0,1.0,300,10,\"A\",9\n0,-0.25,300,10,\"LONGER\",9\n\
                        0,-0.25,300,10,\"LONGER\",9\n0,7.5,300,8,\"LONGER\",9\n";
        assert_eq!(String::from_utf8(lines.as_bytes().to_vec()).unwrap(), expected);
    }
}
