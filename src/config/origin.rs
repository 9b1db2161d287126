//! The printout of where each value comes from.

use std::fmt::Write as _;

use super::load::Loaded;

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
    use crate::config::{Setting, load_text};

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
