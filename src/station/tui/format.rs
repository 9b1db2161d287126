//! Numbers and lines as they are shown.

use posebridge_dashboard::model::Number;

/// A number with this number of decimals, or a dash if there is none.
pub(super) fn fixed(number: Number, decimals: usize) -> String {
    number.get().map_or_else(|| "–".to_owned(), |value| format!("{value:.decimals$}"))
}

/// The same with its sign.
pub(super) fn signed(number: Number, decimals: usize) -> String {
    number.get().map_or_else(|| "–".to_owned(), |value| format!("{value:+.decimals$}"))
}

/// An angle in degrees.
pub(super) fn degrees(radians: Number, decimals: usize) -> String {
    let degrees = radians.get().map_or(f64::NAN, f64::to_degrees);
    fixed(degrees.into(), decimals)
}

/// A number of bytes for people.
pub(super) fn bytes(number: u64) -> String {
    match number {
        ..1_000 => format!("{number} B"),
        1_000..1_000_000 => format!("{:.1} kB", number as f64 / 1e3),
        1_000_000.. => format!("{:.1} MB", number as f64 / 1e6),
    }
}

/// A text from outside without what would steer a terminal: escape sequences go, other control characters become blanks.
pub(super) fn sanitize(text: &str) -> String {
    let mut shown = String::with_capacity(text.len());
    let mut rest = text.chars().peekable();
    while let Some(letter) = rest.next() {
        if letter == '\u{1b}' && rest.next_if_eq(&'[').is_some() {
            // ECMA-48: a control sequence ends with the first of these.
            while rest.next().is_some_and(|next| !('@'..='~').contains(&next)) {}
        } else if letter.is_control() {
            shown.push(' ');
        } else {
            shown.push(letter);
        }
    }
    shown
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_from_outside_steers_the_terminal() {
        assert_eq!(sanitize("\u{1b}[33m WARN\u{1b}[0m it"), " WARN it");
        assert_eq!(sanitize("a\tb\u{7}\u{9b}2J"), "a b  2J");
        assert_eq!(sanitize("\u{1b}]0;title\u{7}"), " ]0;title ");
        assert_eq!(sanitize("\u{1b}[999"), "");
    }

    #[test]
    fn numbers_are_short_and_what_is_none_is_a_dash() {
        assert_eq!(fixed(0.123_45.into(), 3), "0.123");
        assert_eq!(signed(0.5.into(), 1), "+0.5");
        assert_eq!(degrees(std::f64::consts::PI.into(), 0), "180");
        assert_eq!(fixed(f64::NAN.into(), 2), "–");
        assert_eq!(degrees(f64::NAN.into(), 2), "–");
        assert_eq!(
            (bytes(12), bytes(1_234), bytes(56_789_000)),
            ("12 B".to_owned(), "1.2 kB".to_owned(), "56.8 MB".to_owned())
        );
    }
}
