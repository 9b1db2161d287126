//! `posebridge run`: the station.
//!
//! Opens the links, decodes, aligns the clocks, fuses, sends the estimate back, records all inputs, and shows one status block, until
//! Ctrl-C, `--duration` or `--until-silent`. An embedded simulated brick drives its path repeatedly; with `--laps` the run ends with
//! the last lap. With `--tui` a terminal view owns the screen. At the end come tables and two figures, with a simulated brick also the
//! errors.

use anyhow::{Context, Result};
use posebridge_link::ConnectRole;
use posebridge_report::tables::source_table;

use super::args::RunArgs;
use super::deferred_errors::DeferredErrors;
use super::links::LapLimit;
use super::recording_files::RECORDING;
use super::run_report::{finish, report_learned};
use super::session::session;
use super::tui::tty::ensure_terminal;
use crate::config::{self, Config, LinkSection, LinkTarget, RobotProfile, Setting, load_scenario};
use crate::console::print_line;
use crate::exit::{ExitStage, Failure};

pub fn execute(args: &RunArgs) -> Result<(), Failure> {
    let config = configuration(args).before_start()?;
    if args.views.tui {
        ensure_terminal().before_start()?;
    }
    let laps = args.laps.map_or(LapLimit::Endless, LapLimit::Counted);
    let session = run_in_runtime(session(args, &config, RECORDING, laps))?;
    // What cannot be drawn or saved must not cost the rest.
    let mut failures = DeferredErrors::default();
    failures.record(finish(&config, &session.folder, &session.collectors, &session.simulations, &session.recorded));
    failures.record(report_learned(args, &config, &session));
    let has_observations = session.collectors.entries().iter().any(|robot| robot.value.observations > 0);
    failures.record(session.into_result());
    if !has_observations {
        print_line(
            "no robot was heard; `posebridge doctor` looks for ports, rights and settings, and `posebridge doctor URL` listens on a link",
        );
    }
    failures.into_result().while_running()
}

/// Records a robot without a report, for callers that evaluate the recording. Overrides the configured recording by this file in the
/// flags' folder; returns the fusion outcomes of each sensor as a table.
pub fn record(args: &RunArgs, file_name: &str) -> Result<String, Failure> {
    let mut config = configuration(args).before_start()?;
    config.record.enabled = true;
    // A recording that is evaluated must end.
    let laps = args.laps.map_or(LapLimit::OfScenario, LapLimit::Counted);
    let session = run_in_runtime(session(args, &config, file_name, laps))?;
    let robots = session.collectors.entries();
    let sources = robots.first().map_or_else(String::new, |robot| source_table(&robot.value.sources));
    session.into_result().while_running()?;
    Ok(sources)
}

fn run_in_runtime<T>(work: impl Future<Output = Result<T, Failure>>) -> Result<T, Failure> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().before_start()?;
    let result = runtime.block_on(work);
    // An attempt to open a device that hangs must not keep the program alive.
    runtime.shutdown_background();
    result
}

/// Applies the command line's flags.
fn configuration(args: &RunArgs) -> Result<Config> {
    let is_of = |setting: &Setting, sections: &[&str]| {
        let section = setting.path.first();
        section.is_some_and(|section| sections.contains(&section.as_str()))
    };
    let mut settings = args.config.settings.clone();
    if args.robot.is_some() {
        // They may be single keys of the file's robot, and make no sense without it.
        settings.retain(|setting| !is_of(setting, &["robot"]));
    }
    let mut config = config::load(args.config.config.as_deref(), &settings)?.config;
    let flags = &args.links.0;
    if !flags.is_empty() {
        let links = flags
            .iter()
            .map(|flag| LinkSection { listen: flag.role == ConnectRole::Listen, ..LinkSection::new(&flag.url) });
        config.links = links.collect();
    }
    for url in &args.ground_stations {
        let section = LinkSection::for_ground_stations(url);
        config.links.push(section.with_context(|| format!("--gcs {url}"))?);
    }
    if let (Some(name), Some(first)) = (&args.brick, config.links.first_mut()) {
        first.brick = Some(name.clone());
    }
    if let Some(path) = &args.robot {
        config = config.with_robot(RobotProfile::read(path)?);
        // What is set by hand is meant for the robot of the file, too.
        let mut settings = args.config.settings.clone();
        settings.retain(|setting| is_of(setting, &["robot", "filter"]));
        config = config::apply_overrides(&config, &settings)?;
    }
    if let Some(name) = &args.filter {
        config.filter.name.clone_from(name);
    }
    for (target, _) in config.targets()? {
        if let LinkTarget::Sim(name) = target {
            config = config.with_tag_of(&load_scenario(&name)?);
        }
    }
    config.station_config()?;
    config.dashboard.checked()?;
    config.plotjuggler.checked()?;
    Ok(config)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::cli::{Cli, Command};
    use clap::Parser as _;

    /// Commands of the pages, each in one line, without comments and quotes.
    fn commands(page: &Path) -> Vec<Vec<String>> {
        let text = std::fs::read_to_string(page).unwrap();
        let shells = text.split("```sh\n").skip(1);
        let blocks = shells.filter_map(|rest| rest.split("```").next());
        let lines: Vec<String> = blocks
            .flat_map(|block| {
                let joined = block.replace("\\\n", " ");
                joined.lines().map(str::to_owned).collect::<Vec<_>>()
            })
            .collect();
        lines
            .iter()
            .map(|line| line.split(" #").next().unwrap_or_default())
            .filter(|line| line.starts_with("posebridge run") && line.contains("config/robots"))
            .map(|line| line.split_whitespace().map(|word| word.trim_matches('\'').to_owned()).collect())
            .collect()
    }

    #[test]
    fn the_commands_of_the_pages_about_bricks_make_sense() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        let mut found = 0;
        for entry in std::fs::read_dir(root.join("docs/protocols")).unwrap() {
            for command in commands(&entry.unwrap().path()) {
                let cli = Cli::try_parse_from(&command).unwrap();
                let Some(Command::Run(args)) = cli.command else {
                    panic!("{command:?} does not run");
                };
                if let Err(error) = configuration(&args) {
                    panic!("{}: {error:#}", command.join(" "));
                }
                found += 1;
            }
        }
        assert!(found >= 5, "{found} commands");
    }
}
