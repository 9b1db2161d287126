//! The three experiments: what is taken out of a run, given to the analysis, and reported.

use anyhow::{Context, Result, bail};
use posebridge_lab::calibration::at_rest::{MIN_STANDSTILL_S, RestChannel, RestObservations};
use posebridge_lab::noise_identification::{
    AllanPoint, CameraSample, DelaySearch, RestNoise, RestRecord, allan_deviation, cumulative_motion_of, find_delay,
    noise_at_rest, rounding_speed_sigma, straight_noise,
};
use posebridge_report::chart::{Axes, Curve, CurveShape, Plot};
use posebridge_telemetry::{Observation, ObservationKind};

use super::report::{Findings, Quantity};
use super::source::{ExperimentData, FixTimeSource};

/// Height of a panel.
const PANEL_PX: f64 = 300.0;

/// The gyro of a robot that rests.
pub(super) fn rest(data: &ExperimentData) -> Result<Findings> {
    let mut notes = Vec::new();
    let resting = gyro_at_rest(data, &mut notes)?;
    let of_the_gyro = || format!("the gyro of `{}`", data.name);
    let record = RestRecord::from_stretches(&resting.stretches).with_context(of_the_gyro)?;
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
    Ok(Findings {
        name: "identify-rest",
        title: "A gyro at rest".to_owned(),
        quantities,
        notes,
        plots: vec![allan_plot(&points)],
        extra_json: serde_json::Map::new(),
    })
}

/// The gyro while the robot stood; remarks about it go to the notes.
fn gyro_at_rest(data: &ExperimentData, notes: &mut Vec<String>) -> Result<RestChannel> {
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
        return Ok(RestChannel { stretches: vec![all] });
    }
    let resting = RestObservations::from_observations(&observations).gyro;
    let standing = resting.stretches.iter().map(Vec::len).sum::<usize>();
    if standing == 0 {
        bail!(
            "the robot of `{}` never stood: no reading of its gyro lies where the counts of its wheels were the same for {MIN_STANDSTILL_S} s \
             and more; record it standing, or cut such a stretch out with --from and --to",
            data.name
        )
    }
    let left_out = all.len() - standing.min(all.len());
    if left_out > 0 {
        notes.push(format!(
            "{left_out} more lie outside of rest: less than {MIN_STANDSTILL_S} s after a wheel moved, or after the last count of the wheels"
        ));
    }
    Ok(resting)
}

/// The Allan deviation of the longest stretch, and remarks about it.
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

/// The gyro's noise at rest, beside the truth where there is one.
fn rest_quantities(data: &ExperimentData, found: &RestNoise) -> Vec<Quantity> {
    let gyro = data.scenario.as_ref().map(|scenario| scenario.gyro);
    let truth = |of: fn(&posebridge_sim::montecarlo::Gyro) -> f64| gyro.as_ref().map(|gyro| of(gyro).to_radians());
    vec![
        Quantity::new("bias, mean over the rest", "rad/s", found.bias, Some(found.bias_sigma)),
        Quantity::new("gyro_rad_per_s", "rad/s", found.white, Some(found.white_sigma))
            .with_truth(truth(|gyro| gyro.sigma_deg_per_s)),
        Quantity::optional("gyro_resolution_rad_per_s", "rad/s", found.quantum.map(|quantum| (quantum, None)))
            .with_truth(truth(|gyro| gyro.resolution_deg_per_s)),
        Quantity::optional(
            "gyro_bias_walk_rad_per_s_sqrt_s",
            "rad/s/sqrt(s)",
            found.walk.map(|(walk, sigma)| (walk, Some(sigma))),
        )
        .with_truth(truth(|gyro| gyro.bias_walk_deg_per_s_sqrt_s)),
        Quantity::new("angle random walk", "rad/sqrt(s)", found.angle_random_walk, None),
        Quantity::new("sample interval", "s", found.dt_s, None),
    ]
}

fn allan_plot(points: &[AllanPoint]) -> Plot {
    let log = |tau_s: f64, value: f64| (tau_s.log10(), value.log10());
    let measured = points.iter().map(|point| log(point.tau_s, point.deviation)).collect();
    let band = points.iter().map(|point| {
        let (low, high) = (point.deviation - point.sigma, point.deviation + point.sigma);
        (point.tau_s.log10(), low.log10(), high.log10())
    });
    one_panel(
        "Allan deviation at rest",
        "log10 of averaging time [s]",
        "log10 of deviation [rad/s]",
        vec![
            Curve { name: "one sigma".to_owned(), shape: CurveShape::Band(band.collect()) },
            Curve { name: "measured".to_owned(), shape: CurveShape::Dots(measured) },
        ],
    )
}

/// The encoders of a robot that drives straight.
pub(super) fn straight(data: &ExperimentData) -> Result<Findings> {
    let counts = travels(data);
    if counts.is_empty() {
        bail!("run `{}` has no wheel counts", data.name)
    }
    let mut quantities = Vec::new();
    let mut notes = Vec::new();
    let mut curves = Vec::new();
    for (wheel, column) in [("left", 1), ("right", 2)] {
        let travel: Vec<(f64, f64)> = counts
            .windows(2)
            .filter_map(|pair| match pair {
                [a, b] => Some((b[0] - a[0], b[column] - a[column])),
                _ => None,
            })
            .collect();
        let found = straight_noise(&travel).with_context(|| format!("the {wheel} wheel of `{}`", data.name))?;
        let (sigma, of_sigma) = (found.sigma_m_per_s, found.sigma_sigma_m_per_s);
        quantities.push(Quantity::new(format!("speed, {wheel} wheel"), "m/s", found.speed_m_per_s, None));
        quantities.push(Quantity::new(format!("root of R, {wheel} wheel"), "m/s", sigma, Some(of_sigma)));
        let rounding = rounding_speed_sigma(&data.geometry, &travel);
        notes.push(format!(
            "{wheel}: {} intervals, rho(1) {:+.2}; rounding to counts alone makes {rounding:.5} m/s on average over speeds, and rho(1) -0.5",
            found.samples, found.rho_1
        ));
        let speeds = travel.iter().zip(&counts).map(|((dt_s, by_m), from)| (from[0], by_m / dt_s));
        curves.push(Curve { name: format!("{wheel} wheel"), shape: CurveShape::Line(speeds.collect()) });
    }
    let plot = one_panel("A straight run", "time [s]", "speed [m/s]", curves);
    Ok(Findings {
        name: "identify-straight",
        title: "Encoder speed of a straight run".to_owned(),
        quantities,
        notes,
        plots: vec![plot],
        extra_json: serde_json::Map::new(),
    })
}

/// Each instant, s, with how far both wheels have rolled by then, m: by rising time, whatever the order of arrival, each instant once.
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

/// The camera of a robot that turns to and fro.
pub(super) fn delay(data: &ExperimentData, by: FixTimeSource, search: &DelaySearch) -> Result<Findings> {
    let observations: Vec<Observation> = data.observations.iter().map(|one| one.observation).collect();
    let levels = cumulative_motion_of(&observations, &data.geometry);
    let sightings = sightings_of(data, by)?;
    let found = find_delay(&levels, &sightings, search).with_context(|| format!("the camera of `{}`", data.name))?;
    let camera = data.scenario.as_ref().and_then(|scenario| Some((scenario.step_s, scenario.camera?)));
    let truth = camera.map(|(step_s, camera)| match by {
        FixTimeSource::Stamp => 0.0,
        FixTimeSource::Arrival => step_s * f64::from(camera.delay_steps),
    });
    let quantities = vec![
        Quantity::new("delay of the camera", "s", found.delay_s, Some(found.sigma_s)).with_truth(truth),
        Quantity::new("correlation there", "1", found.correlation, None),
    ];
    let what = if found.by_heading { "headings" } else { "paths: the fixes have no heading" };
    let notes = vec![format!("{} fixes, by their {what}", found.fixes)];
    let plot = one_panel(
        "Camera motion against wheel motion",
        "delay [s]",
        "correlation",
        vec![Curve { name: "correlation".to_owned(), shape: CurveShape::Line(found.curve) }],
    );
    Ok(Findings {
        name: "identify-delay",
        title: "Delay of a camera".to_owned(),
        quantities,
        notes,
        plots: vec![plot],
        extra_json: serde_json::Map::new(),
    })
}

/// The camera's fixes in the order of the clock that is asked about.
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
    Plot {
        title: title.to_owned(),
        key_figures: String::new(),
        axes: vec![Axes {
            x_name: x_name.to_owned(),
            y_name: y_name.to_owned(),
            height_px: PANEL_PX,
            is_map: false,
            curves,
        }],
    }
}
