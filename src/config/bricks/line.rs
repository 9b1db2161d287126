//! `[robot.line]`: how a board that prints lines lays them out.

use std::collections::BTreeMap;

use anyhow::{Context, Result, bail, ensure};
use posebridge_protocol::bricks::text_line::{
    ChecksumPolicy, Column, LineLayout, QUANTITIES, Separator, TextLineSettings,
};
use posebridge_telemetry::TimeDelta;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Lines of text. Without this section they are CSV of time_ms, left_ticks and right_ticks.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(default, deny_unknown_fields)]
pub struct LineSection {
    /// CSV: what stands in each column, from left to right; a minus in front turns the sign.
    pub columns: Vec<String>,
    /// Pairs of a name and a value instead, such as t:123|l:45: what each name means.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub keys: BTreeMap<String, String>,
    /// What stands between columns or pairs: one of , ; | : = or a space.
    pub separator: String,
    /// What stands between a name and its value.
    pub key_separator: String,
    /// Lines must end with their checksum; without this it is checked where it stands.
    pub checksum_required: bool,
    /// Print the estimate to the board at most so often; 0 sends it nothing.
    pub estimate_interval_ms: u32,
    /// How old a line without a time may be when it arrives.
    pub delay_ms: u32,
}

impl Default for LineSection {
    fn default() -> Self {
        Self {
            columns: ["time_ms", "left_ticks", "right_ticks"].map(str::to_owned).into(),
            keys: BTreeMap::new(),
            separator: ",".to_owned(),
            key_separator: ":".to_owned(),
            checksum_required: false,
            estimate_interval_ms: 0,
            delay_ms: 40,
        }
    }
}

impl LineSection {
    /// The settings of the codec.
    ///
    /// # Errors
    /// A value makes no sense; the message names its key.
    pub(super) fn settings(&self) -> Result<TextLineSettings> {
        let separator = separator(&self.separator).context("`separator`")?;
        let layout = if self.keys.is_empty() {
            let columns = self.columns.iter().map(|name| column(name));
            LineLayout::Columns { columns: columns.collect::<Result<_>>().context("`columns`")?, separator }
        } else {
            ensure!(self.columns == Self::default().columns, "`keys` and `columns` are two layouts; give one of them");
            let keys = self.keys.iter().map(|(key, name)| {
                let is_plain = !key.is_empty() && key.chars().all(|c| c.is_ascii_graphic());
                ensure!(is_plain, "`{key}` is no name that a board can print");
                Ok((key.clone(), column(name)?))
            });
            LineLayout::Pairs {
                keys: keys.collect::<Result<_>>().context("`keys`")?,
                separator,
                key_separator: self::separator(&self.key_separator).context("`key_separator`")?,
            }
        };
        let settings = TextLineSettings {
            layout,
            checksum: if self.checksum_required { ChecksumPolicy::Required } else { ChecksumPolicy::Optional },
            estimate_interval: (self.estimate_interval_ms > 0)
                .then(|| TimeDelta::from_millis(i64::from(self.estimate_interval_ms))),
            delay: TimeDelta::from_millis(i64::from(self.delay_ms)),
        };
        settings.validate()?;
        Ok(settings)
    }
}

fn column(name: &str) -> Result<Column> {
    Column::from_name(name).with_context(|| {
        let known: Vec<&str> = QUANTITIES.iter().map(|(name, _)| *name).collect();
        format!("`{name}` is no quantity; there are: {}", known.join(", "))
    })
}

fn separator(text: &str) -> Result<Separator> {
    let Some(separator) = Separator::from_text(text) else {
        bail!("`{text}` separates nothing here; there are: , ; | : = and a space")
    };
    Ok(separator)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings(text: &str) -> Result<TextLineSettings, String> {
        let section: LineSection = toml::from_str(text).map_err(|error| error.to_string())?;
        section.settings().map_err(|error| format!("{error:#}"))
    }

    #[test]
    fn without_a_word_it_is_csv_of_time_and_counts() {
        assert_eq!(settings("").unwrap(), TextLineSettings::default());
    }

    #[test]
    fn pairs_and_columns_are_told_apart() {
        let pairs = "separator = \"|\"\nkeys = { t = \"time_ms\", l = \"left_ticks\", r = \"-right_ticks\" }";
        let LineLayout::Pairs { keys, separator, .. } = settings(pairs).unwrap().layout else {
            panic!("pairs were asked for")
        };
        assert_eq!((keys.len(), separator), (3, Separator::Pipe));
        let csv =
            "columns = [\"time_us\", \"ignore\", \"gyro_deg_per_s\"]\nseparator = \";\"\nchecksum_required = true";
        let parsed = settings(csv).unwrap();
        assert_eq!(parsed.checksum, ChecksumPolicy::Required);
        assert!(matches!(parsed.layout, LineLayout::Columns { columns, .. } if columns.len() == 3));
    }

    #[test]
    fn what_cannot_be_is_refused_by_its_key() {
        for (text, expected) in [
            ("columns = [\"speed\"]", "`speed` is no quantity"),
            ("columns = [\"left_ticks\"]", "both are needed"),
            ("separator = \"::\"", "`separator`"),
            ("columns = [\"gyro_deg_per_s\"]\nkeys = { g = \"gyro_deg_per_s\" }", "two layouts"),
            ("keys = { \"\" = \"gyro_deg_per_s\" }", "`keys`"),
        ] {
            let error = settings(text).unwrap_err();
            assert!(error.contains(expected), "{text}: {error}");
        }
    }
}
