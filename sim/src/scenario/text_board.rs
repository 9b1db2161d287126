//! What a simulated board prints.

use serde::de::{Deserialize, Deserializer, Error};

/// `[text_board]`: the lines of a board with `personality = "line"`.
#[derive(Clone, Debug, PartialEq, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TextBoardSettings {
    /// A line, with the names of quantities in braces, such as `{time_ms},{left_ticks},{right_ticks}`.
    #[serde(deserialize_with = "line")]
    pub line: Vec<TextPart>,
    /// Printed at power-up, before the first line; empty prints nothing.
    pub header: String,
}

impl Default for TextBoardSettings {
    fn default() -> Self {
        let fields = [TextField::TimeMs, TextField::LeftTicks, TextField::RightTicks, TextField::GyroDegPerS];
        let comma = TextPart::Words(",".to_owned());
        let parts = fields.map(|field| [comma.clone(), TextPart::Field(field)]);
        Self { line: parts.into_iter().flatten().skip(1).collect(), header: String::new() }
    }
}

/// A part of a printed line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum TextPart {
    Words(String),
    Field(TextField),
}

/// A quantity that a board prints.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TextField {
    TimeMs,
    TimeUs,
    TimeS,
    LeftTicks,
    RightTicks,
    /// Of an encoder whose channels are swapped.
    LeftTicksBackward,
    RightTicksBackward,
    GyroDegPerS,
    GyroRadPerS,
    /// Of a gyro that hangs upside down.
    GyroClockwiseDegPerS,
}

const FIELDS: &[(&str, TextField)] = &[
    ("time_ms", TextField::TimeMs),
    ("time_us", TextField::TimeUs),
    ("time_s", TextField::TimeS),
    ("left_ticks", TextField::LeftTicks),
    ("right_ticks", TextField::RightTicks),
    ("-left_ticks", TextField::LeftTicksBackward),
    ("-right_ticks", TextField::RightTicksBackward),
    ("gyro_deg_per_s", TextField::GyroDegPerS),
    ("gyro_rad_per_s", TextField::GyroRadPerS),
    ("-gyro_deg_per_s", TextField::GyroClockwiseDegPerS),
];

fn line<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<TextPart>, D::Error> {
    let text = String::deserialize(deserializer)?;
    parse_line(&text).map_err(D::Error::custom)
}

fn parse_line(text: &str) -> Result<Vec<TextPart>, String> {
    let mut parts = Vec::new();
    let mut rest = text;
    while let Some((words, behind)) = rest.split_once('{') {
        let (name, after) = behind.split_once('}').ok_or_else(|| format!("`{text}` has a `{{` without its `}}`"))?;
        let field = FIELDS.iter().find(|(known, _)| *known == name);
        let (_, field) = field.ok_or_else(|| {
            let known: Vec<&str> = FIELDS.iter().map(|(name, _)| *name).collect();
            format!("`{name}` is no quantity of a board; there are: {}", known.join(", "))
        })?;
        if !words.is_empty() {
            parts.push(TextPart::Words(words.to_owned()));
        }
        parts.push(TextPart::Field(*field));
        rest = after;
    }
    if !rest.is_empty() {
        parts.push(TextPart::Words(rest.to_owned()));
    }
    Ok(parts)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_has_words_and_quantities_and_nothing_unknown() {
        let csv = parse_line("{time_ms},{left_ticks},{right_ticks},{gyro_deg_per_s}");
        assert_eq!(csv, Ok(TextBoardSettings::default().line));
        let words = parse_line("L {-left_ticks} mm").unwrap();
        assert_eq!(words.len(), 3);
        assert_eq!(words[1], TextPart::Field(TextField::LeftTicksBackward));
        assert!(parse_line("{speed}").unwrap_err().contains("there are: time_ms"));
        assert!(parse_line("{time_ms").unwrap_err().contains("without its"));
    }
}
