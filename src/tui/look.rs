//! How things look: with the terminal's own colours, or without any where NO_COLOR is set (<https://no-color.org>).
//!
//! Nothing is told by colour alone: lines differ in their dots, fixes in their marks, verdicts in their words.

use ratatui::style::{Color, Modifier, Style};

/// Whether there are colours.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Look {
    /// The sixteen of the terminal, which are legible on its own background, dark or light.
    Coloured,
    /// None.
    Plain,
}

/// What is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
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

impl Look {
    /// What a person asked for by `NO_COLOR`: any value but an empty one.
    #[must_use]
    pub fn of_environment(no_color: Option<&std::ffi::OsStr>) -> Self {
        if no_color.is_some_and(|value| !value.is_empty()) { Self::Plain } else { Self::Coloured }
    }

    /// The style of a text.
    #[must_use]
    pub const fn style(self, role: Role) -> Style {
        match self {
            Self::Coloured => Style::new().fg(colour(role)).add_modifier(weight(role)),
            Self::Plain => Style::new().add_modifier(weight(role)),
        }
    }

    /// The colour of a line or mark on the map.
    #[must_use]
    pub const fn colour(self, role: Role) -> Color {
        match self {
            Self::Coloured => colour(role),
            Self::Plain => Color::Reset,
        }
    }
}

const fn colour(role: Role) -> Color {
    match role {
        Role::Quiet | Role::Path => Color::DarkGray,
        Role::Strong | Role::Truth => Color::Reset,
        Role::Odometry => Color::Red,
        Role::Estimate => Color::LightBlue,
        Role::Good => Color::Green,
        Role::Late => Color::Yellow,
        Role::Bad => Color::Magenta,
    }
}

const fn weight(role: Role) -> Modifier {
    match role {
        Role::Strong => Modifier::BOLD,
        Role::Quiet
        | Role::Path
        | Role::Truth
        | Role::Odometry
        | Role::Estimate
        | Role::Good
        | Role::Late
        | Role::Bad => Modifier::empty(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_color_counts_when_it_is_not_empty() {
        assert_eq!(Look::of_environment(None), Look::Coloured);
        assert_eq!(Look::of_environment(Some("".as_ref())), Look::Coloured);
        assert_eq!(Look::of_environment(Some("1".as_ref())), Look::Plain);
        assert_eq!(Look::Plain.style(Role::Bad), Style::new());
    }
}
