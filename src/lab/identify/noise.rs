//! The three noise experiments: data selection, analysis and report.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use posebridge_lab::noise_identification::{
    AllanPoint, CameraSample, DelaySearch, MIN_STANDSTILL_S, RestIntervals, RestNoise, RestRecord, allan_deviation,
    cumulative_motion_of, find_delay, noise_at_rest, readings_at_rest, rounding_speed_sigma, straight_noise,
};
use posebridge_report::chart::{Axes, Curve, CurveShape, Plot};
use posebridge_report::report::Report;
use posebridge_sim::montecarlo::Scenario;
use posebridge_telemetry::{DriveGeometry, Observation, ObservationKind};

use super::report::{Quantity, end_of_interval, report};
use crate::config::Setting;
use crate::exit::{ExitStage, Failure};
use crate::flags::DataFlags;
use crate::lab::drives;
use crate::lab::experiments::live::LiveArgs;
use crate::lab::source;
use crate::tools::experiment_output::OutputArgs;
use crate::tools::own_recording;

const PANEL_PX: f64 = 300.0;

pub(super) fn rest(data: &ExperimentData) -> Result<Report> {
    let mut notes = Vec::new();
    let resting = gyro_at_rest(data, &mut notes)?;
    let of_the_gyro = || format!("the gyro of `{}`", data.name);
    let record = RestRecord::from_stretches(&resting).with_context(of_the_gyro)?;
    let found = noise_at_rest(&record).with_context(of_the_gyro)?;
    let quantities = rest_quantities(data, &found);
    notes.insert(0, format!("{} samples over {:.0} s", found.samples, found.rest_s));
    let silences = record.silences();
    if !silences.is_empty() {
        notes.push(format!(
            "the gyro was silent {} time(s), for {:.0} s in all: what lies between is left out",
            silences.len(),
            silences.iter().sum::<f64>()
        ));
    }
    let points = longest_allan(&record, &mut notes);
    let plots = [allan_plot(&points)];
    Ok(report("identify-rest", "A gyro at rest", &data.name, &quantities, &notes, &plots))
}

/// Gyro readings at rest; remarks go to `notes`.
fn gyro_at_rest(data: &ExperimentData, notes: &mut Vec<String>) -> Result<RestIntervals> {
    let mut observations: Vec<Observation> = data.observations.iter().map(|one| one.observation).collect();
    observations.sort_by_key(|observation| observation.stamp);
    let rate = |observation: &Observation| {
        let ObservationKind::TurnRate(rate) = observation.measurement else {
            return None;
        };
        Some((observation.stamp.as_secs_f64(), rate.0))
    };
    let all: Vec<(f64, f64)> = observations.iter().filter_map(rate).collect();
    if all.is_empty() {
        bail!("run `{}` has no gyro", data.name)
    }
    let is_wheel = |one: &Observation| matches!(one.measurement, ObservationKind::WheelAngles { .. });
    if !observations.iter().any(is_wheel) {
        notes.push("there are no wheel counts: that the robot stood is taken on trust".to_owned());
        return Ok(vec![all]);
    }
    let [resting, ..] = readings_at_rest(&observations);
    let resting_count = resting.iter().map(Vec::len).sum::<usize>();
    if resting_count == 0 {
        bail!(
            "the robot of `{}` never stood: no reading of its gyro lies where the counts of its wheels were the same for {MIN_STANDSTILL_S} s \
             and more; record it standing, or cut such a stretch out with --from and --to",
            data.name
        )
    }
    let left_out = all.len() - resting_count.min(all.len());
    if left_out > 0 {
        notes.push(format!(
            "{left_out} more lie outside of rest: less than {MIN_STANDSTILL_S} s after a wheel moved, or after the last count of the wheels"
        ));
    }
    Ok(resting)
}

/// The Allan deviation of the longest stretch; remarks go to `notes`.
fn longest_allan(record: &RestRecord, notes: &mut Vec<String>) -> Vec<AllanPoint> {
    if record.stretches().len() > 1 {
        notes.push(format!(
            "there are {} stretches of rest; the Allan deviation is that of the longest one, {} samples",
            record.stretches().len(),
            record.longest().len()
        ));
    }
    let rates: Vec<f64> = record.longest().iter().map(|(_, rate)| *rate).collect();
    let points = allan_deviation(&rates, record.interval_s());
    let bottom = points.iter().copied().min_by(|a, b| a.deviation.total_cmp(&b.deviation));
    if let Some(bottom) = bottom {
        notes.push(format!(
            "bias instability, the lowest Allan deviation: {:.2e} ± {:.1e} rad/s at {:.1} s",
            bottom.deviation, bottom.sigma, bottom.tau_s
        ));
    }
    points
}

fn rest_quantities(data: &ExperimentData, found: &RestNoise) -> Vec<Quantity> {
    let gyro = data.scenario.as_ref().map(|scenario| scenario.gyro);
    let truth = |of: fn(&posebridge_sim::montecarlo::Gyro) -> f64| gyro.as_ref().map(|gyro| of(gyro).to_radians());
    vec![
        Quantity::new("bias, mean over the rest", "rad/s", found.bias, found.bias_sigma),
        Quantity::new("gyro_rad_per_s", "rad/s", found.white, found.white_sigma)
            .with_truth(truth(|gyro| gyro.sigma_deg_per_s)),
        Quantity::new("gyro_resolution_rad_per_s", "rad/s", found.quantum, None)
            .with_truth(truth(|gyro| gyro.resolution_deg_per_s)),
        Quantity::new(
            "gyro_bias_walk_rad_per_s_sqrt_s",
            "rad/s/sqrt(s)",
            found.walk.map(|(walk, _)| walk),
            found.walk.map(|(_, sigma)| sigma),
        )
        .with_truth(truth(|gyro| gyro.bias_walk_deg_per_s_sqrt_s)),
        Quantity::new("angle random walk", "rad/sqrt(s)", found.angle_random_walk, None),
        Quantity::new("sample interval", "s", found.dt_s, None),
    ]
}

fn allan_plot(points: &[AllanPoint]) -> Plot {
    let log = |tau_s: f64, value: f64| (tau_s.log10(), value.log10());
    let measured = points.iter().map(|point| log(point.tau_s, point.deviation));
    let band = points.iter().map(|point| {
        let (low, high) = (point.deviation - point.sigma, point.deviation + point.sigma);
        (point.tau_s.log10(), low.log10(), high.log10())
    });
    one_panel(
        "Allan deviation at rest",
        "log10 of averaging time [s]",
        "log10 of deviation [rad/s]",
        vec![Curve::new("one sigma", CurveShape::Band(band.collect())), Curve::dots("measured", measured)],
    )
}

pub(super) fn straight(data: &ExperimentData) -> Result<Report> {
    let counts = travels(data);
    if counts.is_empty() {
        bail!("run `{}` has no wheel counts", data.name)
    }
    let mut quantities = Vec::new();
    let mut notes = Vec::new();
    let mut curves = Vec::new();
    for (wheel, column) in [("left", 1), ("right", 2)] {
        let pairs = counts.iter().zip(counts.iter().skip(1));
        let travel: Vec<(f64, f64)> = pairs.map(|(a, b)| (b[0] - a[0], b[column] - a[column])).collect();
        let found = straight_noise(&travel).with_context(|| format!("the {wheel} wheel of `{}`", data.name))?;
        let (sigma, of_sigma) = (found.sigma_m_per_s, found.sigma_sigma_m_per_s);
        quantities.push(Quantity::new(format!("speed, {wheel} wheel"), "m/s", found.speed_m_per_s, None));
        quantities.push(Quantity::new(format!("root of R, {wheel} wheel"), "m/s", sigma, of_sigma));
        let rounding = rounding_speed_sigma(&data.geometry, &travel);
        notes.push(format!(
            "{wheel}: {} intervals, rho(1) {:+.2}; rounding to counts alone makes {rounding:.5} m/s on average over speeds, and rho(1) -0.5",
            found.samples, found.rho_1
        ));
        let speeds = travel.iter().zip(&counts).map(|((dt_s, by_m), from)| (from[0], by_m / dt_s));
        curves.push(Curve::line(format!("{wheel} wheel"), speeds));
    }
    let plots = [one_panel("A straight run", "time [s]", "speed [m/s]", curves)];
    let title = "Encoder speed of a straight run";
    Ok(report("identify-straight", title, &data.name, &quantities, &notes, &plots))
}

/// Time, s, and cumulative travel of both wheels, m; sorted by time, without repeated instants.
fn travels(data: &ExperimentData) -> Vec<[f64; 3]> {
    let mut counts: Vec<[f64; 3]> = Vec::new();
    for one in &data.observations {
        if let ObservationKind::WheelAngles { left, right } = one.observation.measurement {
            let geometry = &data.geometry;
            let at_s = one.observation.stamp.as_secs_f64();
            counts.push([at_s, left.0 * geometry.left_wheel_radius.0, right.0 * geometry.right_wheel_radius.0]);
        }
    }
    // An interval of no time, or back in time, would be no speed.
    counts.sort_by(|[one_s, ..], [other_s, ..]| one_s.total_cmp(other_s));
    counts.dedup_by(|[later_s, ..], [earlier_s, ..]| later_s <= earlier_s);
    counts
}

pub(super) fn delay(data: &ExperimentData, by: FixTimeSource, search: &DelaySearch) -> Result<Report> {
    let observations: Vec<Observation> = data.observations.iter().map(|one| one.observation).collect();
    let levels = cumulative_motion_of(&observations, &data.geometry);
    let sightings = sightings_of(data, by)?;
    let found = find_delay(&levels, &sightings, search).with_context(|| format!("the camera of `{}`", data.name))?;
    let camera = data.scenario.as_ref().and_then(|scenario| Some((scenario.step_s, scenario.camera?)));
    let truth = camera.map(|(step_s, camera)| match by {
        FixTimeSource::Stamp => 0.0,
        FixTimeSource::Arrival => step_s * f64::from(camera.delay_steps),
    });
    let quantities = [
        Quantity::new("delay of the camera", "s", found.delay_s, found.sigma_s).with_truth(truth),
        Quantity::new("correlation there", "1", found.correlation, None),
    ];
    let what = if found.by_heading { "headings" } else { "paths: the fixes have no heading" };
    let notes = [format!("{} fixes, by their {what}", found.fixes)];
    let curve = Curve::line("correlation", found.curve);
    let plots = [one_panel("Camera motion against wheel motion", "delay [s]", "correlation", vec![curve])];
    Ok(report("identify-delay", "Delay of a camera", &data.name, &quantities, &notes, &plots))
}

fn sightings_of(data: &ExperimentData, by: FixTimeSource) -> Result<Vec<CameraSample>> {
    let mut sightings = Vec::new();
    for one in &data.observations {
        let ObservationKind::Fix(fix) = one.observation.measurement else {
            continue;
        };
        let at_s = match by {
            FixTimeSource::Stamp => Some(one.observation.stamp.as_secs_f64()),
            FixTimeSource::Arrival => one.arrival_s,
        };
        let at_s = at_s.with_context(|| {
            format!(
                "`{}`: when a fix arrived by the clock of the brick is not known, because the brick never answered TIMESYNC; take \
                 `--by stamp`",
                data.name
            )
        })?;
        sightings.push(CameraSample {
            at_s,
            position_m: [fix.position.x.0, fix.position.y.0],
            heading_rad: fix.heading.map(posebridge_telemetry::Heading::rad),
        });
    }
    sightings.sort_by(|a, b| a.at_s.total_cmp(&b.at_s));
    Ok(sightings)
}

fn one_panel(title: &str, x_name: &str, y_name: &str, curves: Vec<Curve>) -> Plot {
    Plot::new(title, "", vec![Axes::new(x_name, y_name, PANEL_PX, curves)])
}

pub(super) struct ExperimentSource {
    instruction: &'static str,
    scenario: &'static str,
}

pub(super) const REST: ExperimentSource = ExperimentSource {
    instruction: "leave the robot standing, its motors off; ten minutes tell the walk of a gyro's bias, too",
    scenario: include_str!("scenarios/rest.toml"),
};
pub(super) const STRAIGHT: ExperimentSource = ExperimentSource {
    instruction: "drive the robot straight on at an even speed; --from and --to cut off how it starts and stops",
    scenario: include_str!("scenarios/straight.toml"),
};
pub(super) const DELAY: ExperimentSource = ExperimentSource {
    instruction: "let the robot turn to and fro before the camera for half a minute",
    scenario: include_str!("scenarios/delay.toml"),
};

/// By which instant a fix is taken for seen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum FixTimeSource {
    /// By its stamp.
    Stamp,
    /// By its arrival.
    Arrival,
}

/// Flags that say what to look at.
#[derive(clap::Args, Clone, Debug)]
pub struct SourceArgs {
    /// Descriptor (config/recordings/*.toml) or recording (*.mcap). Default: a simulated drive.
    #[arg(long, value_name = "FILE", group = "real_robot")]
    pub recording: Option<PathBuf>,
    /// A live robot.
    #[command(flatten)]
    pub live: LiveArgs,
    /// Read the first run of a descriptor whose name begins with this text.
    #[arg(long, value_name = "PREFIX", requires = "recording")]
    pub run: Option<String>,
    /// Folder for the relative paths of a descriptor. Default: POSEBRIDGE_DATA, or else the descriptor's folder.
    #[arg(long, value_name = "DIR", env = "POSEBRIDGE_DATA")]
    pub data: Option<PathBuf>,
    /// Set one key of the robot, as in `replay`, or of the configuration of a posebridge recording. Can be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE", value_parser = Setting::parse, requires = "real_robot")]
    pub settings: Vec<Setting>,
    /// Scenario to simulate instead of the bundled one: a scenario of `lab accuracy`, or a TOML file.
    #[arg(long, value_name = "NAME|FILE.toml", conflicts_with = "real_robot")]
    pub sim: Option<String>,
    /// Seed of a simulated drive.
    #[arg(long, value_name = "N", default_value_t = 1, conflicts_with = "real_robot")]
    pub seed: u64,
    /// Use data from this time on, in seconds after the first observation.
    #[arg(long, value_name = "SECONDS", default_value_t = 0.0)]
    pub from: f64,
    /// Use data up to this time, in seconds after the first observation.
    #[arg(long, value_name = "SECONDS")]
    pub to: Option<f64>,
}

pub(super) struct ArrivedObservation {
    /// By the clock of the timestamps; `None` where it is unknown.
    pub(super) arrival_s: Option<f64>,
    pub(super) observation: Observation,
}

pub(super) struct ExperimentData {
    pub(super) name: String,
    pub(super) observations: Vec<ArrivedObservation>,
    pub(super) geometry: DriveGeometry,
    /// The truth of a simulated drive.
    pub(super) scenario: Option<Scenario>,
}

impl SourceArgs {
    pub(super) fn read(&self, experiment: &ExperimentSource, output: &OutputArgs) -> Result<ExperimentData, Failure> {
        if let Some(live) = self.live.record(output, None, &self.settings, experiment.instruction)? {
            // The keys that are set stand in the recording.
            return read_run(&live, &self.flags(None, Vec::new())).and_then(|data| self.crop(data)).while_running();
        }
        let data = match &self.recording {
            Some(path) => {
                // Every fix is looked at: none needs to be withheld.
                let every = (!own_recording::is_own(path)).then_some(1);
                read_run(path, &self.flags(every, self.settings.clone()))
            }
            None => self.simulate(experiment.scenario),
        };
        data.and_then(|data| self.crop(data)).before_start()
    }

    fn flags(&self, use_every: Option<usize>, settings: Vec<Setting>) -> DataFlags {
        DataFlags { data: self.data.clone(), run: self.run.clone(), use_every, settings }
    }

    fn crop(&self, mut data: ExperimentData) -> Result<ExperimentData> {
        let first_s =
            data.observations.iter().map(|one| one.observation.stamp.as_secs_f64()).fold(f64::INFINITY, f64::min);
        let until_s = end_of_interval(self.from, self.to)?;
        data.observations.retain(|one| {
            let at_s = one.observation.stamp.as_secs_f64() - first_s;
            self.from <= at_s && at_s <= until_s
        });
        ensure!(!data.observations.is_empty(), "no observation of `{}` lies between --from and --to", data.name);
        Ok(data)
    }

    fn simulate(&self, bundled: &str) -> Result<ExperimentData> {
        let (name, scenario) = match &self.sim {
            None => ("bundled experiment".to_owned(), Scenario::from_toml(bundled)?),
            Some(requested) => drives::load_scenario(requested)?,
        };
        let scenario = scenario.with_seed(self.seed);
        let drive = scenario.drive(0);
        let arrivals = drive.arrivals.iter();
        Ok(ExperimentData {
            name: format!("{name}, seed {}", self.seed),
            observations: arrivals
                .map(|arrival| ArrivedObservation {
                    arrival_s: Some(drive.time_at(arrival.step).as_secs_f64()),
                    observation: arrival.observation,
                })
                .collect(),
            geometry: drive.prior.geometry,
            scenario: Some(scenario),
        })
    }
}

fn read_run(path: &Path, flags: &DataFlags) -> Result<ExperimentData> {
    let run = source::load_run(path, None, flags)?;
    let arrived = run.observations.iter().enumerate().map(|(index, observation)| ArrivedObservation {
        arrival_s: run.arrivals_s.as_ref().and_then(|all| all.get(index).copied()),
        observation: *observation,
    });
    Ok(ExperimentData {
        observations: arrived.collect(),
        geometry: run.config.geometry,
        name: run.name,
        scenario: None,
    })
}
