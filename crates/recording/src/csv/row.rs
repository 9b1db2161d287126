//! One line of a CSV file.

use posebridge_telemetry::RobotId;

/// A line for one stream.
pub(super) struct CsvRow {
    pub(super) stream: &'static str,
    pub(super) header: &'static str,
    pub(super) fields: Vec<CsvField>,
    /// Whom the line is about, in a stream that is about robots: its last column.
    pub(super) robot: Option<RobotId>,
}

/// The text of a value, before it is quoted; empty for a missing one.
#[derive(Default)]
pub(super) struct CsvField(String);

impl AsRef<[u8]> for CsvField {
    fn as_ref(&self) -> &[u8] {
        self.0.as_bytes()
    }
}

impl From<f64> for CsvField {
    fn from(number: f64) -> Self {
        // What is no number is nothing to a spreadsheet.
        if number.is_finite() { Self(number.to_string()) } else { Self::default() }
    }
}

impl From<u64> for CsvField {
    fn from(count: u64) -> Self {
        Self(count.to_string())
    }
}

impl From<bool> for CsvField {
    fn from(flag: bool) -> Self {
        u64::from(flag).into()
    }
}

impl From<&str> for CsvField {
    fn from(text: &str) -> Self {
        Self(text.to_owned())
    }
}

impl From<String> for CsvField {
    fn from(text: String) -> Self {
        Self(text)
    }
}

impl<T: Into<Self>> From<Option<T>> for CsvField {
    fn from(value: Option<T>) -> Self {
        value.map_or_else(Self::default, Into::into)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_keep_their_digits_and_a_missing_value_is_empty() {
        assert_eq!(CsvField::from(0.1 + 0.2).0, "0.30000000000000004");
        assert_eq!(CsvField::from(f64::NAN).0, "");
        assert_eq!(CsvField::from(true).0, "1");
        assert_eq!(CsvField::from(Option::<f64>::None).0, "");
    }
}
