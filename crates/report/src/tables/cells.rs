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

pub fn degrees(radians: Option<f64>) -> String {
    two_digits(radians.map(f64::to_degrees))
}

/// Two digits after the point.
pub(super) fn two_digits(value: Option<f64>) -> String {
    or_no_value(value, |value| format!("{value:.2}"))
}

/// A count in full.
pub(super) fn count_or_dash(value: Option<impl ToString>) -> String {
    or_no_value(value, |value| value.to_string())
}

/// One digit after the point; powers of ten where that would flood the column.
fn number(value: f64) -> String {
    if value.abs() < 1e9 { format!("{value:.1}") } else { format!("{value:.3e}") }
}

/// Three significant digits where there are fewer before the point: these errors span five decades.
pub fn millimetres_three_digits(metres: Option<f64>) -> String {
    three_digits(metres.map(|metres| metres * 1e3))
}

/// Three significant digits; all that stand before the point, and powers of ten where that would flood a column.
pub fn three_digits(value: Option<f64>) -> String {
    let Some(value) = value else {
        return NO_VALUE.to_owned();
    };
    match value.abs() {
        size if size >= 1e5 || !size.is_finite() => format!("{value:.1e}"),
        size if size >= 99.95 => format!("{value:.0}"),
        size if size >= 9.995 => format!("{value:.1}"),
        size if size >= 0.9995 => format!("{value:.2}"),
        _ => format!("{value:.3}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_keep_three_digits_over_five_decades() {
        let cells = [0.00133, 0.0137, 0.2244, 1.8121, 425.462].map(|metres| millimetres_three_digits(Some(metres)));
        assert_eq!(cells, ["1.33", "13.7", "224", "1812", "4.3e5"]);
        assert_eq!(three_digits(Some(0.0104)), "0.010");
        assert_eq!(three_digits(None), "-");
    }
}
