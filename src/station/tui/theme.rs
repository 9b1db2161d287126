//! Styles and number formats: the terminal's own colours, or none if NO_COLOR is set (<https://no-color.org>).
//!
//! Colour alone never carries information: lines differ in their dots, fixes in their marks, verdicts in their words.

use posebridge_dashboard::model::Number;
use posebridge_telemetry::is_printable;
use ratatui::style::{Color, Modifier, Style};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Theme {
    /// The sixteen of the terminal, which are legible on its own background, dark or light.
    Coloured,
    Plain,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StyleRole {
    /// Borders, units, hints.
    Quiet,
    Strong,
    Path,
    Truth,
    Odometry,
    Estimate,
    Good,
    Late,
    /// A rejected fix, or an error.
    Bad,
}

impl Theme {
    /// `NO_COLOR` set to any non-empty value.
    pub fn from_env(no_color: Option<&std::ffi::OsStr>) -> Self {
        if no_color.is_some_and(|value| !value.is_empty()) { Self::Plain } else { Self::Coloured }
    }

    pub const fn style(self, role: StyleRole) -> Style {
        match self {
            Self::Coloured => Style::new().fg(colour(role)).add_modifier(weight(role)),
            Self::Plain => Style::new().add_modifier(weight(role)),
        }
    }

    pub const fn colour(self, role: StyleRole) -> Color {
        match self {
            Self::Coloured => colour(role),
            Self::Plain => Color::Reset,
        }
    }
}

const fn colour(role: StyleRole) -> Color {
    match role {
        StyleRole::Quiet | StyleRole::Path => Color::DarkGray,
        StyleRole::Strong | StyleRole::Truth => Color::Reset,
        StyleRole::Odometry => Color::Red,
        StyleRole::Estimate => Color::LightBlue,
        StyleRole::Good => Color::Green,
        StyleRole::Late => Color::Yellow,
        StyleRole::Bad => Color::Magenta,
    }
}

const fn weight(role: StyleRole) -> Modifier {
    if matches!(role, StyleRole::Strong) { Modifier::BOLD } else { Modifier::empty() }
}

/// A dash for a missing number.
pub(super) fn fixed(number: Number, decimals: usize) -> String {
    number.get().map_or_else(|| "–".to_owned(), |value| format!("{value:.decimals$}"))
}

pub(super) fn signed(number: Number, decimals: usize) -> String {
    number.get().map_or_else(|| "–".to_owned(), |value| format!("{value:+.decimals$}"))
}

pub(super) fn degrees(radians: Number, decimals: usize) -> String {
    let degrees = radians.get().map_or(f64::NAN, f64::to_degrees);
    fixed(degrees.into(), decimals)
}

pub(super) fn bytes(number: u64) -> String {
    match number {
        ..1_000 => format!("{number} B"),
        1_000..1_000_000 => format!("{:.1} kB", number as f64 / 1e3),
        1_000_000.. => format!("{:.1} MB", number as f64 / 1e6),
    }
}

/// Sanitises a line: escape sequences are removed, what else is not printable becomes spaces.
pub(super) fn sanitize(text: &str) -> String {
    let mut shown = String::with_capacity(text.len());
    let mut rest = text.chars().peekable();
    while let Some(letter) = rest.next() {
        if letter == '\u{1b}' && rest.next_if_eq(&'[').is_some() {
            // ECMA-48: a control sequence ends with the first of these.
            while rest.next().is_some_and(|next| !('@'..='~').contains(&next)) {}
        } else {
            shown.push(if is_printable(letter) { letter } else { ' ' });
        }
    }
    shown
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_color_counts_when_it_is_not_empty() {
        assert_eq!(Theme::from_env(None), Theme::Coloured);
        assert_eq!(Theme::from_env(Some("".as_ref())), Theme::Coloured);
        assert_eq!(Theme::from_env(Some("1".as_ref())), Theme::Plain);
        assert_eq!(Theme::Plain.style(StyleRole::Bad), Style::new());
    }

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
