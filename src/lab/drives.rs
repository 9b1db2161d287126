//! Monte-Carlo drives for commands: scenario files, the filter's prior, and the reference for the score.

use posebridge_telemetry::StartPose;
use std::path::Path;
use std::sync::Arc;

use anyhow::{Context, Result};
use posebridge_estimator::models::slow_sensor::SlowSensor;
use posebridge_estimator::{FilterConfig, Params};
use posebridge_lab::accuracy::{ObservationArrival, ReferenceDrive};
use posebridge_report::TimedPose;
use posebridge_sim::montecarlo::{Drive, FilterPrior, SCENARIOS, Scenario};

use crate::config::{Config, RobotCalibration, RobotFile, RobotMounting, RobotNoise, apply_profile};
use crate::text_file::read_text;

/// A bundled scenario by its name, else one from a TOML file, named after the file.
pub fn load_scenario(requested: &str) -> Result<(String, Scenario)> {
    let path = Path::new(requested);
    let is_bundled = SCENARIOS.iter().any(|(name, _)| *name == requested);
    let is_file = path.extension().is_some_and(|extension| extension == "toml");
    if is_bundled || !is_file {
        return Ok((requested.to_owned(), Scenario::bundled(requested)?));
    }
    let text = read_text(path).with_context(|| format!("reading the scenario `{requested}`"))?;
    let scenario = Scenario::from_toml(&text).with_context(|| format!("scenario `{requested}`"))?;
    let name = path.file_stem().map_or_else(|| requested.to_owned(), |stem| stem.to_string_lossy().into_owned());
    Ok((name, scenario))
}

/// What the filters of a scenario are built from: its own numbers, and on top its `[profile]`, checked as a robot's file is.
pub fn filter_config(prior: &FilterPrior) -> Result<FilterConfig> {
    let drawn = drawn_config(prior);
    if prior.profile.is_empty() {
        return Ok(drawn);
    }
    let robot = RobotFile {
        noise: RobotNoise::from(drawn.noise),
        calibration: RobotCalibration::from(drawn.calibration),
        mounting: RobotMounting::from(&drawn.calibration.mountings),
        ..RobotFile::default().with_geometry(&drawn.geometry)
    };
    let config = Config { robot, ..Config::default() };
    let profile = apply_profile(&config, &prior.profile).and_then(|config| config.filter_config());
    let told = profile.context("[profile]")?;
    let start = told.start.or(drawn.start);
    Ok(FilterConfig { start, arena_map: drawn.arena_map, ..told })
}

/// What a filter is told that knows the distributions from which a run draws.
pub fn drawn_config(prior: &FilterPrior) -> FilterConfig {
    let start = StartPose {
        pose: prior.start,
        position_sigma_m: prior.start_position_sigma_m,
        heading_sigma_rad: prior.start_heading_sigma_rad,
    };
    FilterConfig {
        geometry: prior.geometry,
        noise: prior.noise,
        start: prior.start_is_known.then_some(start),
        params: Params::default(),
        calibration: prior.calibration,
        arena_map: Arc::clone(&prior.arena_map),
        slow_sensor: SlowSensor::UNKNOWN,
    }
}

pub fn known_drive(drive: &Drive) -> ReferenceDrive {
    let truth = drive.truth.iter().enumerate().map(|(step, pose)| TimedPose { time: drive.time_at(step), pose: *pose });
    let arrivals = drive.arrivals.iter().map(|arrival| ObservationArrival {
        step: arrival.step,
        measured_step: arrival.measured_step,
        observation: arrival.observation,
    });
    ReferenceDrive {
        truth: truth.collect(),
        arrivals: arrivals.collect(),
        scored_from: drive.scored_from,
        landings: drive.landings.clone(),
        slip_bursts: drive.slip_bursts.clone(),
    }
}
