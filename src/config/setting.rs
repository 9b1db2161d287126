//! A key and its value from the command line.

use std::fmt;

/// A key and a value from `--set KEY=VALUE`.
#[derive(Clone, Debug, PartialEq)]
pub struct Setting {
    /// The key's path, from the outside in.
    pub path: Vec<String>,
    /// The value.
    pub value: toml::Value,
}

impl Setting {
    /// Understands `a.b=VALUE`; a value that is no TOML is taken as text.
    ///
    /// # Errors
    /// There is no `=`, or a part of the key is empty.
    pub fn parse(text: &str) -> Result<Self, String> {
        let (key, value) = text.split_once('=').ok_or_else(|| format!("`{text}` has no `=`: write KEY=VALUE"))?;
        let path: Vec<String> = key.trim().split('.').map(str::to_owned).collect();
        if path.iter().any(String::is_empty) {
            return Err(format!("`{key}` has an empty part: write for example robot.track_width_m=0.112"));
        }
        let value = value.trim();
        let parsed = toml::from_str::<toml::Table>(&format!("v = {value}")).ok();
        let value =
            parsed.and_then(|mut table| table.remove("v")).unwrap_or_else(|| toml::Value::String(value.to_owned()));
        Ok(Self { path, value })
    }

    /// Lays the value over a table, making tables on the way.
    ///
    /// # Errors
    /// A part of the path is there already and is no table.
    pub fn apply_to(&self, table: &mut toml::Table) -> Result<(), String> {
        let Some((last, way)) = self.path.split_last() else {
            return Ok(());
        };
        let mut table = table;
        for part in way {
            let entry = table.entry(part.clone()).or_insert_with(|| toml::Value::Table(toml::Table::new()));
            table = entry.as_table_mut().ok_or_else(|| format!("`{part}` is no table"))?;
        }
        // Whole numbers are fine where a fraction is possible: 1 means 1.0.
        let value = match (&self.value, table.get(last)) {
            (toml::Value::Integer(whole), Some(toml::Value::Float(_))) => toml::Value::Float(*whole as f64),
            _ => self.value.clone(),
        };
        table.insert(last.clone(), value);
        Ok(())
    }
}

impl fmt::Display for Setting {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}={}", self.path.join("."), self.value)
    }
}
