//! Colours of a terminal (ECMA-48, select graphic rendition).

use super::metrics::VerdictTone;

/// Whether text has colours.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Colour {
    Plain,
    Ansi,
}

impl Colour {
    pub fn paint(self, tone: VerdictTone, text: &str) -> String {
        let code = match tone {
            VerdictTone::Good => 32,
            VerdictTone::Inconclusive => 33,
            VerdictTone::Bad => 31,
        };
        match self {
            Self::Plain => text.to_owned(),
            Self::Ansi => format!("\x1b[{code}m{text}\x1b[0m"),
        }
    }
}
