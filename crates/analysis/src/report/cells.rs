//! Numbers as they stand in the cells of the tables.

/// What stands in a cell without a value.
pub const NO_VALUE: &str = "-";

/// The value as `show` writes it, if there is one.
pub(super) fn or_no_value<T>(value: Option<T>, show: impl FnOnce(T) -> String) -> String {
    value.map_or_else(|| NO_VALUE.to_owned(), show)
}

pub(super) fn millimetres(metres: Option<f64>) -> String {
    or_no_value(metres, |metres| number(metres * 1e3))
}

pub(super) fn degrees(radians: Option<f64>) -> String {
    two_digits(radians.map(f64::to_degrees))
}

/// Two digits after the point.
pub(super) fn two_digits(value: Option<f64>) -> String {
    or_no_value(value, |value| format!("{value:.2}"))
}

/// A count in full.
pub(super) fn count(value: Option<impl ToString>) -> String {
    or_no_value(value, |value| value.to_string())
}

/// One digit after the point; powers of ten where that would flood the column.
fn number(value: f64) -> String {
    if value.abs() < 1e9 { format!("{value:.1}") } else { format!("{value:.3e}") }
}
