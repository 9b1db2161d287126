//! Numbers as they are sent.

use posebridge_telemetry::{HostClock, Timestamp};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A measured quantity with about seven digits, far below the resolution of any sensor; `null` if it is not finite.
#[derive(Clone, Copy, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(transparent)]
pub struct Number(Option<f32>);

impl Number {
    /// The number, if it is finite.
    pub fn get(self) -> Option<f64> {
        self.0.map(f64::from)
    }
}

impl From<f64> for Number {
    fn from(value: f64) -> Self {
        let short = value as f32;
        Self(short.is_finite().then_some(short))
    }
}

/// An instant in seconds, to the microsecond: the shortest decimals stay short.
pub(crate) fn seconds_of(at: Timestamp<HostClock>) -> f64 {
    at.as_micros() as f64 / 1e6
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_short_and_what_is_none_is_null() {
        let json = |value: f64| serde_json::to_string(&Number::from(value)).unwrap();
        assert_eq!(json(0.1), "0.1");
        assert_eq!(json(-1.0 / 3.0), "-0.33333334");
        assert_eq!(json(f64::NAN), "null");
        assert_eq!(json(f64::INFINITY), "null");
        assert_eq!(json(1e300), "null");
        assert_eq!(seconds_of(Timestamp::from_nanos(265_885_334)), 0.265_885);
    }
}
