//! The layout of a board's lines, as its user configures it.

use std::fmt;

use posebridge_telemetry::TimeDelta;

/// The settings of one board that prints lines. The default is CSV of `time_ms,left_ticks,right_ticks`.
#[derive(Clone, Debug, PartialEq)]
pub struct TextLineSettings {
    pub layout: LineLayout,
    pub checksum: ChecksumPolicy,
    /// Shortest time between two estimates printed to the board; `None` sends none. A board that takes single letters
    /// or digits as commands would execute parts of such a line, so this must be configured.
    pub estimate_interval: Option<TimeDelta>,
    /// Largest age of a line without a time at its arrival: its values are from any time within this interval before.
    pub delay: TimeDelta,
    /// Of a column `gyro_counts`: what the gyro reads at one degree per second.
    pub gyro_counts_per_deg_per_s: f64,
}

/// MPU-6050 at its range of ±250 degrees per second: data sheet, 6.1.
const DEFAULT_GYRO_COUNTS: f64 = 131.0;

impl Default for TextLineSettings {
    fn default() -> Self {
        let columns = [Quantity::TimeMs, Quantity::LeftTicks, Quantity::RightTicks];
        Self {
            layout: LineLayout::Columns { columns: columns.map(Column::new).to_vec(), separator: Separator::Comma },
            checksum: ChecksumPolicy::Optional,
            estimate_interval: None,
            delay: TimeDelta::from_millis(40),
            gyro_counts_per_deg_per_s: DEFAULT_GYRO_COUNTS,
        }
    }
}

impl TextLineSettings {
    /// Rejects a repeated quantity, one wheel without the other, a layout without any measurement, and a gyro without a scale.
    pub fn validate(&self) -> Result<(), LayoutError> {
        let columns: Vec<Column> = self.layout.columns().collect();
        let has_column = |quantity: Quantity| columns.iter().any(|column| column.quantity == quantity);
        if !columns.iter().any(|column| column.quantity.is_measured()) {
            return Err(LayoutError::Empty);
        }
        if has_column(Quantity::LeftTicks) != has_column(Quantity::RightTicks) {
            return Err(LayoutError::SingleWheel);
        }
        if !(self.gyro_counts_per_deg_per_s.is_finite() && self.gyro_counts_per_deg_per_s > 0.0) {
            return Err(LayoutError::GyroScale(self.gyro_counts_per_deg_per_s));
        }
        for (index, column) in columns.iter().enumerate() {
            let kind = column.quantity.kind();
            let before = columns.iter().take(index);
            if kind != QuantityKind::Ignored && before.into_iter().any(|other| other.quantity.kind() == kind) {
                return Err(LayoutError::Duplicate(column.quantity));
            }
        }
        Ok(())
    }
}

/// Why a layout is invalid.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum LayoutError {
    #[error(
        "the layout has nothing that is measured; there are: left_ticks and right_ticks, gyro_.., distance_.., temperature_c, battery_v"
    )]
    Empty,
    #[error("the layout has one of left_ticks and right_ticks; both are needed")]
    SingleWheel,
    /// The same quantity again, or in another unit.
    #[error("the layout has `{0}` and the same quantity before it")]
    Duplicate(Quantity),
    #[error("`gyro_counts_per_deg_per_s` is {0}, must be more than zero")]
    GyroScale(f64),
}

/// The quantities in a line and their separators.
#[derive(Clone, Debug, PartialEq)]
pub enum LineLayout {
    /// Values in a fixed order, all of them in every line: CSV.
    Columns { columns: Vec<Column>, separator: Separator },
    /// Names and values in any order, such as `t:123|l:45|r:46`.
    Pairs { keys: Vec<(String, Column)>, separator: Separator, key_separator: Separator },
}

impl LineLayout {
    pub(super) fn columns(&self) -> impl Iterator<Item = Column> + '_ {
        let (columns, keys): (&[Column], &[(String, Column)]) = match self {
            Self::Columns { columns, .. } => (columns, &[]),
            Self::Pairs { keys, .. } => (&[], keys),
        };
        let keys = keys.iter().map(|(_, column)| *column);
        columns.iter().copied().chain(keys)
    }
}

impl fmt::Display for LineLayout {
    /// The line with the quantities instead of numbers.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Columns { columns, separator } => {
                for (index, column) in columns.iter().enumerate() {
                    let text = if *separator == Separator::Words { " .. " } else { separator.text() };
                    let between = if index > 0 { text } else { "" };
                    write!(f, "{between}{column}")?;
                }
            }
            Self::Pairs { keys, separator, key_separator } => {
                for (index, (key, column)) in keys.iter().enumerate() {
                    let between = if index > 0 { separator.text() } else { "" };
                    write!(f, "{between}{key}{}<{column}>", key_separator.text())?;
                }
            }
        }
        Ok(())
    }
}

/// A quantity with its sign.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Column {
    pub quantity: Quantity,
    pub sense: ColumnSign,
}

impl Column {
    pub const fn new(quantity: Quantity) -> Self {
        Self { quantity, sense: ColumnSign::Normal }
    }

    /// The column with this name, such as `left_ticks`, or `-gyro_deg_per_s` for a gyro that counts clockwise. `None`
    /// if there is none, or if the quantity has no sign to invert.
    pub fn from_name(name: &str) -> Option<Self> {
        let (plain, sense) = match name.strip_prefix('-') {
            Some(plain) => (plain, ColumnSign::Inverted),
            None => (name, ColumnSign::Normal),
        };
        let (_, quantity) = QUANTITIES.iter().find(|(known, _)| *known == plain)?;
        let can_turn = matches!(quantity.kind(), QuantityKind::Left | QuantityKind::Right | QuantityKind::TurnRate);
        (sense == ColumnSign::Normal || can_turn).then_some(Self { quantity: *quantity, sense })
    }
}

impl fmt::Display for Column {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let sign = match self.sense {
            ColumnSign::Normal => "",
            ColumnSign::Inverted => "-",
        };
        write!(f, "{sign}{}", self.quantity)
    }
}

/// The positive direction of a column.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ColumnSign {
    /// Forward and counter-clockwise are positive.
    #[default]
    Normal,
    /// Backward and clockwise are positive.
    Inverted,
}

/// The quantity of a column.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// Milliseconds of the board's clock, a whole number that wraps at 2^32: Arduino's `millis()`.
    TimeMs,
    /// Microseconds of the board's clock, a whole number that wraps at 2^32: Arduino's `micros()`.
    TimeUs,
    /// Seconds of the board's clock, with a fraction.
    TimeS,
    LeftTicks,
    RightTicks,
    GyroDegPerS,
    GyroRadPerS,
    /// A gyro's own numbers; [`TextLineSettings::gyro_counts_per_deg_per_s`] has their scale.
    GyroCounts,
    /// Range straight ahead in millimetres; zero and less mean none.
    DistanceMm,
    /// Range straight ahead in centimetres; zero and less mean none.
    DistanceCm,
    /// Range straight ahead in metres; zero and less mean none.
    DistanceM,
    TemperatureC,
    /// Volts of the battery.
    BatteryV,
    Ignore,
}

/// Every quantity with the name that the configuration uses.
pub const QUANTITIES: &[(&str, Quantity)] = &[
    ("time_ms", Quantity::TimeMs),
    ("time_us", Quantity::TimeUs),
    ("time_s", Quantity::TimeS),
    ("left_ticks", Quantity::LeftTicks),
    ("right_ticks", Quantity::RightTicks),
    ("gyro_deg_per_s", Quantity::GyroDegPerS),
    ("gyro_rad_per_s", Quantity::GyroRadPerS),
    ("gyro_counts", Quantity::GyroCounts),
    ("distance_mm", Quantity::DistanceMm),
    ("distance_cm", Quantity::DistanceCm),
    ("distance_m", Quantity::DistanceM),
    ("temperature_c", Quantity::TemperatureC),
    ("battery_v", Quantity::BatteryV),
    ("ignore", Quantity::Ignore),
];

/// The physical quantity, whatever its unit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum QuantityKind {
    Time,
    Left,
    Right,
    TurnRate,
    Range,
    Temperature,
    Battery,
    Ignored,
}

impl Quantity {
    pub(crate) const fn kind(self) -> QuantityKind {
        match self {
            Self::TimeMs | Self::TimeUs | Self::TimeS => QuantityKind::Time,
            Self::LeftTicks => QuantityKind::Left,
            Self::RightTicks => QuantityKind::Right,
            Self::GyroDegPerS | Self::GyroRadPerS | Self::GyroCounts => QuantityKind::TurnRate,
            Self::DistanceMm | Self::DistanceCm | Self::DistanceM => QuantityKind::Range,
            Self::TemperatureC => QuantityKind::Temperature,
            Self::BatteryV => QuantityKind::Battery,
            Self::Ignore => QuantityKind::Ignored,
        }
    }

    const fn is_measured(self) -> bool {
        !matches!(self.kind(), QuantityKind::Time | QuantityKind::Ignored)
    }
}

impl fmt::Display for Quantity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let named = QUANTITIES.iter().find(|(_, quantity)| quantity == self);
        f.write_str(named.map_or("", |(name, _)| name))
    }
}

/// A separator in a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Separator {
    Comma,
    Semicolon,
    Pipe,
    Colon,
    Equals,
    /// Any run of spaces and tabs.
    Blank,
    /// Anything that is no number.
    Words,
}

impl Separator {
    pub fn from_text(text: &str) -> Option<Self> {
        let all = [Self::Comma, Self::Semicolon, Self::Pipe, Self::Colon, Self::Equals, Self::Blank, Self::Words];
        if text == "\t" {
            return Some(Self::Blank);
        }
        all.into_iter().find(|separator| separator.text() == text)
    }

    pub const fn text(self) -> &'static str {
        match self {
            Self::Comma => ",",
            Self::Semicolon => ";",
            Self::Pipe => "|",
            Self::Colon => ":",
            Self::Equals => "=",
            Self::Blank => " ",
            Self::Words => "words",
        }
    }
}

/// Whether lines must end with their checksum: `*` and the exclusive or of all characters before it as two hexadecimal digits. As in NMEA
/// 0183 a `$` at the beginning does not count.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ChecksumPolicy {
    /// Verified if present.
    #[default]
    Optional,
    Required,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn checked(names: &[&str]) -> Result<(), LayoutError> {
        let columns = names.iter().map(|name| Column::from_name(name).unwrap());
        let settings = TextLineSettings {
            layout: LineLayout::Columns { columns: columns.collect(), separator: Separator::Comma },
            ..TextLineSettings::default()
        };
        settings.validate()
    }

    #[test]
    fn every_name_is_that_of_its_quantity_and_only_signed_ones_turn() {
        for (name, quantity) in QUANTITIES {
            assert_eq!(Column::from_name(name), Some(Column::new(*quantity)));
            assert_eq!(quantity.to_string(), *name);
        }
        let turned = Column::from_name("-gyro_deg_per_s").unwrap();
        assert_eq!(turned.to_string(), "-gyro_deg_per_s");
        assert_eq!(Column::from_name("-time_ms"), None);
        assert_eq!(Column::from_name("gyro"), None);
    }

    #[test]
    fn a_layout_that_cannot_be_is_refused() {
        assert_eq!(TextLineSettings::default().validate(), Ok(()));
        assert_eq!(checked(&["ignore", "gyro_deg_per_s", "ignore"]), Ok(()));
        assert_eq!(checked(&["time_ms", "ignore"]), Err(LayoutError::Empty));
        assert_eq!(checked(&["left_ticks"]), Err(LayoutError::SingleWheel));
        let twice = checked(&["gyro_deg_per_s", "gyro_rad_per_s"]);
        assert_eq!(twice, Err(LayoutError::Duplicate(Quantity::GyroRadPerS)));
    }

    #[test]
    fn a_separator_is_found_by_its_text() {
        for text in [",", ";", "|", ":", "=", " ", "words"] {
            assert_eq!(Separator::from_text(text).map(Separator::text), Some(text));
        }
        assert_eq!(Separator::from_text("\t"), Some(Separator::Blank));
        assert_eq!(Separator::from_text("::"), None);
    }
}
