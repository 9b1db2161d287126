//! Values with a display unit, a text format and an optional standard deviation.

use serde_json::{Value, json};

use super::tables::{NO_VALUE, three_digits};

/// Display unit of an SI value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unit {
    /// The SI unit, or no unit, without a name.
    None,
    /// The value's own unit, with this name.
    Named(&'static str),
    Millimetres,
    Degrees,
    Milliseconds,
    MillimetresPerSecond,
    DegreesPerSecond,
    Percent,
}

impl Unit {
    fn scale(self) -> f64 {
        match self {
            Self::None | Self::Named(_) => 1.0,
            Self::Millimetres | Self::Milliseconds | Self::MillimetresPerSecond => 1e3,
            Self::Degrees | Self::DegreesPerSecond => 1_f64.to_degrees(),
            Self::Percent => 100.0,
        }
    }

    const fn name(self) -> &'static str {
        match self {
            Self::None => "",
            Self::Named(name) => name,
            Self::Millimetres => "mm",
            Self::Degrees => "deg",
            Self::Milliseconds => "ms",
            Self::MillimetresPerSecond => "mm/s",
            Self::DegreesPerSecond => "deg/s",
            Self::Percent => "%",
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Precision {
    Decimals(usize),
    /// For values over several decades.
    ThreeDigits,
}

/// Text format of a value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Format {
    unit: Unit,
    precision: Precision,
    /// With a plus sign for values that are not negative.
    is_signed: bool,
}

impl Format {
    /// `digits` after the point.
    pub const fn new(unit: Unit, digits: usize) -> Self {
        Self { unit, precision: Precision::Decimals(digits), is_signed: false }
    }

    pub const fn three_digits(unit: Unit) -> Self {
        Self { unit, precision: Precision::ThreeDigits, is_signed: false }
    }

    /// Adds a plus sign to values that are not negative.
    pub const fn signed(self) -> Self {
        Self { is_signed: true, ..self }
    }

    /// Without unit; a dash for `None`.
    pub fn number(self, value: Option<f64>) -> String {
        match (value.map(|value| value * self.unit.scale()), self.precision) {
            (None, _) => NO_VALUE.to_owned(),
            (value, Precision::ThreeDigits) => three_digits(value),
            (Some(value), Precision::Decimals(digits)) if self.is_signed => format!("{value:+.digits$}"),
            (Some(value), Precision::Decimals(digits)) => format!("{value:.digits$}"),
        }
    }

    /// Number and standard deviation, without unit.
    pub(crate) fn uncertain_number(self, value: Option<f64>, sigma: Option<f64>) -> String {
        let number = self.number(value);
        match value.and(sigma) {
            Some(sigma) => format!("{number} ± {}", Self { is_signed: false, ..self }.number(Some(sigma))),
            None => number,
        }
    }

    pub fn text(self, value: f64) -> String {
        self.append_unit(&self.number(Some(value)))
    }

    pub(crate) fn append_unit(self, text: &str) -> String {
        let name = self.unit.name();
        if name.is_empty() { text.to_owned() } else { format!("{text} {name}") }
    }
}

/// A named value with unit and optional standard deviation.
#[derive(Clone, Debug)]
pub struct Quantity {
    pub(crate) key: &'static str,
    pub(crate) label: String,
    value: Option<f64>,
    sigma: Option<f64>,
    format: Format,
}

impl Quantity {
    /// `key` is for JSON, `label` for the text. An empty key omits it from JSON.
    pub fn new(key: &'static str, label: impl Into<String>, value: f64, format: Format) -> Self {
        Self { key, label: label.into(), value: Some(value), sigma: None, format }
    }

    /// `None` is `null` in JSON and omitted from the text.
    pub fn optional(key: &'static str, label: impl Into<String>, value: Option<f64>, format: Format) -> Self {
        Self { key, label: label.into(), value, sigma: None, format }
    }

    /// In JSON an object of `value` and `sigma`.
    pub fn with_sigma(self, sigma: f64) -> Self {
        Self { sigma: Some(sigma), ..self }
    }

    pub(crate) fn text(&self) -> Option<String> {
        self.value?;
        Some(self.format.append_unit(&self.format.uncertain_number(self.value, self.sigma)))
    }

    pub(crate) fn json(&self) -> Value {
        match self.sigma {
            Some(sigma) => json!({ "value": self.value, "sigma": sigma }),
            None => json!(self.value),
        }
    }
}
