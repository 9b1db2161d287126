//! `posebridge config`: prints the configuration with origins, checks it, or prints its schema or its parameters.

use std::fmt::Write as _;

use clap::{Args, Subcommand};
use posebridge_report::tables::wrapped;

use crate::config::{self, Config, Loaded};
use crate::console::print_result;
use crate::exit::{ExitStage, Failure};
use crate::flags::ConfigFlags;

/// Flags of `config`.
#[derive(Args, Clone, Debug)]
pub struct ConfigArgs {
    /// What to do with it.
    #[command(subcommand)]
    pub action: ConfigAction,
}

/// What to do with the configuration.
#[derive(Clone, Debug, Subcommand)]
pub enum ConfigAction {
    /// Print every key with its value and where it comes from.
    Print(ConfigFlags),
    /// Check a configuration. Prints nothing if it is valid.
    Check(ConfigFlags),
    /// Print the JSON schema.
    Schema,
    /// Print every parameter of the filters, i.e. the keys of `[filter]`; ground stations can set them while the station runs.
    Params,
}

pub fn execute(args: &ConfigArgs) -> Result<(), Failure> {
    match &args.action {
        ConfigAction::Print(flags) => {
            let loaded = load_config(flags)?;
            print_result(&config::print(&loaded).while_running()?).while_running()?;
        }
        ConfigAction::Check(flags) => {
            load_config(flags)?;
        }
        ConfigAction::Schema => {
            let schema = serde_json::to_string_pretty(&schema()).while_running()?;
            print_result(&(schema + "\n")).while_running()?;
        }
        ConfigAction::Params => print_result(&params()).while_running()?,
    }
    Ok(())
}

fn load_config(flags: &ConfigFlags) -> Result<Loaded, Failure> {
    let loaded = config::load(flags.config.as_deref(), &flags.settings).before_start()?;
    loaded.config.validate().before_start()?;
    Ok(loaded)
}

/// One line each: key, default, range, unit and meaning.
pub fn params() -> String {
    let mut text = String::new();
    for row in posebridge_estimator::PARAMS {
        let range = format!("{} to {}", row.range.start(), row.range.end());
        // Writing to a String cannot fail.
        let _ = writeln!(text, "{:<16} {:>8}   {range:<18} {}", row.key, row.default, row.unit);
        text += &wrapped("    ", row.doc);
    }
    text
}

/// With the filters and their tunables from their tables.
pub fn schema() -> serde_json::Value {
    let mut schema = schemars::schema_for!(Config).to_value();
    let filters: Vec<_> = posebridge_estimator::FILTERS.iter().map(|entry| entry.name).collect();
    if let Some(section) = schema.pointer_mut("/$defs/FilterSection") {
        section["properties"]["name"]["enum"] = serde_json::json!(filters);
        for row in posebridge_estimator::PARAMS {
            section["properties"][row.key] = serde_json::json!({
                "type": "number",
                "description": row.doc,
                "default": row.default,
                "minimum": row.range.start(),
                "maximum": row.range.end(),
                "unit": row.unit,
            });
        }
        section["additionalProperties"] = serde_json::json!(false);
    }
    schema
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_tunable_has_a_line_with_its_range() {
        let text = params();
        assert_eq!(text.lines().filter(|line| !line.starts_with(' ')).count(), posebridge_estimator::PARAMS.len());
        assert!(text.contains("slip_nis            10.83   4 to 100"), "{text}");
    }
}
