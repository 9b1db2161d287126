//! One line of a CSV file.

use std::io::Write;

use posebridge_telemetry::RobotId;

/// A line for one stream.
pub(super) struct CsvRow {
    pub(super) stream: &'static str,
    pub(super) header: &'static str,
    pub(super) fields: Vec<CsvField>,
    /// Whom the line is about, in a stream that is about robots: its last column.
    pub(super) robot: Option<RobotId>,
}

/// What stands between two commas.
pub(super) enum CsvField {
    Number(f64),
    Count(u64),
    Flag(bool),
    Text(String),
    Empty,
}

impl CsvField {
    pub(super) fn write(&self, out: &mut impl Write) -> std::io::Result<()> {
        match self {
            // What is no number is nothing to a spreadsheet.
            Self::Number(number) if number.is_finite() => write!(out, "{number}"),
            Self::Number(_) | Self::Empty => Ok(()),
            Self::Count(count) => write!(out, "{count}"),
            Self::Flag(flag) => write!(out, "{}", u8::from(*flag)),
            Self::Text(text) => write_text(text, out),
        }
    }
}

/// Quoted where it has to be.
fn write_text(text: &str, out: &mut impl Write) -> std::io::Result<()> {
    if text.contains([',', '"', '\n', '\r']) {
        write!(out, "\"{}\"", text.replace('"', "\"\""))
    } else {
        out.write_all(text.as_bytes())
    }
}

impl From<f64> for CsvField {
    fn from(number: f64) -> Self {
        Self::Number(number)
    }
}

impl From<u64> for CsvField {
    fn from(count: u64) -> Self {
        Self::Count(count)
    }
}

impl From<bool> for CsvField {
    fn from(flag: bool) -> Self {
        Self::Flag(flag)
    }
}

impl From<&str> for CsvField {
    fn from(text: &str) -> Self {
        Self::Text(text.to_owned())
    }
}

impl From<String> for CsvField {
    fn from(text: String) -> Self {
        Self::Text(text)
    }
}

impl<T: Into<Self>> From<Option<T>> for CsvField {
    fn from(value: Option<T>) -> Self {
        value.map_or(Self::Empty, Into::into)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_keep_their_digits_and_texts_are_quoted_where_they_must_be() {
        let written = |field: CsvField| {
            let mut out = Vec::new();
            field.write(&mut out).unwrap();
            String::from_utf8(out).unwrap()
        };
        assert_eq!(written(CsvField::Number(0.1 + 0.2)), "0.30000000000000004");
        assert_eq!(written(CsvField::Number(f64::NAN)), "");
        assert_eq!(written(true.into()), "1");
        assert_eq!(written(Option::<f64>::None.into()), "");
        assert_eq!(written("a \"b\", c".into()), "\"a \"\"b\"\", c\"");
    }
}
