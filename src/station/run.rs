//! `posebridge run`: the station, until Ctrl-C, `--duration`, `--until-silent`, or with `--laps` the last lap of the embedded simulated
//! brick. At the end come tables and two figures, with a simulated brick also the errors.

use std::path::Path;

use anyhow::{Context, Result};
use posebridge_link::ConnectRole;
use posebridge_report::tables::source_table;

use super::args::{RecordFlags, RunArgs};
use super::links::LapLimit;
use super::recording_files::RECORDING;
use super::run_report::{finish, save_learned};
use super::session::session;
use super::setup::RobotSetup;
use super::tui::tty::ensure_terminal;
use super::wiring_fix::wiring_text;
use crate::config::{self, Config, LinkSection, LinkTarget, RobotProfile, Setting, load_scenario};
use crate::console::{print_line, print_result};
use crate::exit::{DeferredErrors, ExitStage, Failure};
use crate::flags::{ConfigFlags, DashboardFlags, LinkFlag, LinkFlags};
use crate::runtime::run_in_runtime;

pub fn execute(args: &RunArgs) -> Result<(), Failure> {
    let config = configuration(args).before_start()?;
    if args.views.tui {
        ensure_terminal().before_start()?;
    }
    let laps = args.laps.map_or(LapLimit::Endless, LapLimit::Counted);
    let session = run_in_runtime(session(args, &config, RECORDING, laps)).before_start()??;
    // What cannot be drawn or saved must not cost the rest.
    let mut failures = DeferredErrors::default();
    failures.record(finish(args, &config, &session));
    failures.record(save_learned(args, &config, &session));
    if args.fix_wiring {
        failures.record(print_result(&wiring_text(&session.wiring)).context("the wiring is not printed"));
    }
    let missing_sensors = session.missing_sensors.clone();
    let has_observations = session.collectors.entries().iter().any(|robot| robot.value.observations > 0);
    failures.record(session.into_result());
    if !has_observations {
        let is_named = config.links.iter().any(|link| link.brick.is_some() || link.url.starts_with("sim://"));
        if let Some(brick) = config.robot.described_brick().filter(|_| !is_named) {
            print_line(&format!(
                "the robot's file has a table for --brick {brick}, and its link was taken for MAVLink: add --brick {brick}"
            ));
        }
        for line in &missing_sensors {
            print_line(line);
        }
        if missing_sensors.is_empty() {
            print_line(
                "no robot was heard; `posebridge doctor` looks for ports, rights and settings, `posebridge doctor URL` listens on a link, and \
             `posebridge init --guide --probe --link URL` asks a LEGO brick, which says nothing by itself",
            );
        }
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
    let session = run_in_runtime(session(args, &config, file_name, laps)).before_start()??;
    let robots = session.collectors.entries();
    let sources = robots.first().map_or_else(String::new, |robot| source_table(&robot.value.sources));
    session.into_result().while_running()?;
    Ok(sources)
}

/// Runs a station for some seconds, without recording and page. `links` replace those of the configuration, if there are any.
pub fn check_setup(config: &Path, links: &[String], duration_s: f64) -> Result<Vec<RobotSetup>, Failure> {
    let links = links.iter().map(|url| LinkFlag { url: url.clone(), role: ConnectRole::Dial });
    let args = RunArgs {
        config: ConfigFlags { config: Some(config.to_owned()), ..ConfigFlags::default() },
        links: LinkFlags(links.collect()),
        duration: Some(duration_s),
        record: RecordFlags { no_record: true, ..RecordFlags::default() },
        page: DashboardFlags { no_dashboard: true, ..DashboardFlags::default() },
        ..RunArgs::default()
    };
    let config = configuration(&args).before_start()?;
    let session = run_in_runtime(session(&args, &config, RECORDING, LapLimit::Endless)).before_start()??;
    // It is empty without a recording.
    drop(std::fs::remove_dir(&session.folder));
    Ok(session.setup)
}

/// Applies the command line's flags.
pub fn configuration(args: &RunArgs) -> Result<Config> {
    let is_of = |setting: &Setting, sections: &[&str]| {
        let section = setting.path.first();
        section.is_some_and(|section| sections.contains(&section.as_str()))
    };
    // The sensor first, so that single keys of it can be set.
    let sensor = args.sensor.as_deref().map(config::sensor_setting).transpose()?;
    let given: Vec<Setting> = sensor.into_iter().chain(args.config.settings.iter().cloned()).collect();
    let mut settings = given.clone();
    if args.robot.is_some() {
        // They may be single keys of the file's robot, and make no sense without it.
        settings.retain(|setting| !is_of(setting, &["robot"]));
    }
    let mut config = config::load(args.config.config.as_deref(), &settings)?.config;
    let flags = &args.links.0;
    if !flags.is_empty() {
        // Another address of what the file's link at this position leads to, unless one of both is simulated.
        let is_simulated = |url: &str| url.starts_with("sim://");
        let links = flags.iter().enumerate().map(|(index, flag)| {
            let of_file = config.links.get(index).filter(|link| !is_simulated(&link.url) && !is_simulated(&flag.url));
            let link = of_file.cloned().unwrap_or_else(|| LinkSection::new(&flag.url));
            LinkSection { url: flag.url.clone(), listen: flag.role == ConnectRole::Listen, ..link }
        });
        config.links = links.collect();
    }
    for url in &args.ground_stations {
        let section = LinkSection::for_ground_stations(url);
        config.links.push(section.with_context(|| format!("--gcs {url}"))?);
    }
    for camera in &args.cameras {
        config.links.push(LinkSection::for_camera(camera).with_context(|| format!("--camera {camera}"))?);
    }
    if let (Some(name), Some(first)) = (&args.brick, config.links.first_mut()) {
        first.brick = Some(name.clone());
    }
    if let Some(path) = &args.robot {
        config = config.with_robot(RobotProfile::read(path)?);
        // What is set by hand is meant for the robot of the file, too.
        let mut settings = given;
        settings.retain(|setting| is_of(setting, &["robot", "filter"]));
        config = config::apply_overrides(&config, &settings)?;
    }
    if let Some(name) = &args.filter {
        config.filter.name.clone_from(name);
    }
    if !args.compare.is_empty() {
        config.filter.compare.clone_from(&args.compare);
    }
    for (target, _) in config.targets()? {
        if let LinkTarget::Sim(name) = target {
            let scenario = load_scenario(&name)?;
            config = config.with_camera_of(&scenario).with_rendered_camera(&scenario)?;
        }
    }
    args.fleet.apply(&mut config.fleet, &mut config.ros2);
    let config = config.with_cameras_read()?;
    config.validate()?;
    Ok(config)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flag_is_another_address_of_the_link_at_its_position() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("robot.toml");
        let text = "[[link]]\nurl = \"serial:brick.tty\"\nbrick = \"nxt\"\n[[link]]\nurl = \"udp://127.0.0.1:1\"\naccept_mavlink1 = true\n";
        std::fs::write(&path, text).unwrap();
        let links_of = |urls: &[&str]| {
            let flags = urls.iter().map(|url| LinkFlag { url: (*url).to_owned(), role: ConnectRole::Dial });
            let args = RunArgs {
                config: ConfigFlags { config: Some(path.clone()), ..ConfigFlags::default() },
                links: LinkFlags(flags.collect()),
                ..RunArgs::default()
            };
            configuration(&args).unwrap().links
        };
        let links = links_of(&["tcp://127.0.0.1:2", "udp://127.0.0.1:3", "udp://127.0.0.1:4"]);
        let kept: Vec<_> =
            links.iter().map(|link| (link.url.as_str(), link.brick.as_deref(), link.accept_mavlink1)).collect();
        assert_eq!(
            kept,
            [
                ("tcp://127.0.0.1:2", Some("nxt"), false),
                ("udp://127.0.0.1:3", None, true),
                ("udp://127.0.0.1:4", None, false)
            ]
        );
        // A simulated robot is another one.
        assert_eq!(links_of(&["sim://square"])[0].brick, None);
    }
}
