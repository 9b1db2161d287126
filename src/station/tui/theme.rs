//! How things look: with the terminal's own colours, or without any where NO_COLOR is set (<https://no-color.org>).
//!
//! Colour alone never carries information: lines differ in their dots, fixes in their marks, verdicts in their words.

use ratatui::style::{Color, Modifier, Style};

/// Whether there are colours.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Theme {
    /// The sixteen of the terminal, which are legible on its own background, dark or light.
    Coloured,
    /// None.
    Plain,
}

/// What is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StyleRole {
    /// Frames, units, what is only there to help.
    Quiet,
    /// Titles and keys.
    Strong,
    /// The path to be driven.
    Path,
    /// The truth.
    Truth,
    /// The brick's own odometry.
    Odometry,
    /// The estimate.
    Estimate,
    /// An observation that was used.
    Good,
    /// One that came late.
    Late,
    /// One that was refused, or something that is wrong.
    Bad,
}

impl Theme {
    /// What a person asked for by `NO_COLOR`: any value but an empty one.
    pub fn from_env(no_color: Option<&std::ffi::OsStr>) -> Self {
        if no_color.is_some_and(|value| !value.is_empty()) { Self::Plain } else { Self::Coloured }
    }

    /// The style of a text.
    pub const fn style(self, role: StyleRole) -> Style {
        match self {
            Self::Coloured => Style::new().fg(colour(role)).add_modifier(weight(role)),
            Self::Plain => Style::new().add_modifier(weight(role)),
        }
    }

    /// The colour of a line or mark on the map.
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
    match role {
        StyleRole::Strong => Modifier::BOLD,
        StyleRole::Quiet
        | StyleRole::Path
        | StyleRole::Truth
        | StyleRole::Odometry
        | StyleRole::Estimate
        | StyleRole::Good
        | StyleRole::Late
        | StyleRole::Bad => Modifier::empty(),
    }
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
}
