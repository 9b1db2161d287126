//! Settings from the command line, and the printout that tells where each value comes from.

use std::fmt;
use std::fmt::Write as _;

use super::load::Loaded;

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
    pub fn lay_over(&self, table: &mut toml::Table) -> Result<(), String> {
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

/// Where a value comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Origin {
    /// It was not given.
    Default,
    /// It stands in the file.
    File,
    /// It was given with `--set`.
    Flag,
}

/// The whole configuration as TOML keys with their origins.
///
/// # Errors
/// The configuration cannot be written as TOML, which would be a fault of ours.
pub fn print(loaded: &Loaded) -> anyhow::Result<String> {
    let table = toml::Table::try_from(&loaded.config)?;
    let mut lines = String::new();
    print_table(&table, &mut Vec::new(), loaded, &mut lines);
    Ok(lines)
}

fn print_table(table: &toml::Table, path: &mut Vec<String>, loaded: &Loaded, lines: &mut String) {
    for (key, value) in table {
        path.push(key.clone());
        if let toml::Value::Table(inner) = value {
            print_table(inner, path, loaded, lines);
        } else {
            let origin = match origin_of(path, loaded) {
                Origin::Default => "default",
                Origin::File => "file",
                Origin::Flag => "flag",
            };
            // Writing to a String cannot fail.
            let _ = writeln!(lines, "{} = {value}    # {origin}", path.join("."));
        }
        path.pop();
    }
}

fn origin_of(path: &[String], loaded: &Loaded) -> Origin {
    if loaded.settings.iter().any(|setting| setting.path == path) {
        return Origin::Flag;
    }
    let mut table = &loaded.file;
    let Some((last, way)) = path.split_last() else {
        return Origin::Default;
    };
    for part in way {
        match table.get(part).and_then(toml::Value::as_table) {
            Some(inner) => table = inner,
            None => return Origin::Default,
        }
    }
    if table.contains_key(last) { Origin::File } else { Origin::Default }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::load_text;

    #[test]
    fn a_setting_reaches_its_key_and_says_that_it_was_a_flag() {
        let settings = [Setting::parse("robot.track_width_m=1").unwrap()];
        let loaded = load_text("test", "[robot]\nname = \"a\"\n", &settings).unwrap();
        assert_eq!(loaded.config.robot.track_width_m, 1.0);
        let printed = print(&loaded).unwrap();
        assert!(printed.contains("robot.track_width_m = 1.0    # flag"), "{printed}");
        assert!(printed.contains("robot.name = \"a\"    # file"), "{printed}");
        assert!(printed.contains("robot.ticks_per_turn = 360.0    # default"), "{printed}");
    }

    #[test]
    fn the_embedded_default_says_what_the_code_says() {
        let loaded = load_text("default", crate::config::DEFAULT_TOML, &[]).unwrap();
        assert_eq!(loaded.config, crate::config::Config::default());
    }
}
