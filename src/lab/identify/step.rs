//! `posebridge identify step`: gain, dead time and lags of a sensor or a motor, from the samples of one step or several.
//!
//! Without a recording on a simulated sensor with known parameters. docs/lab/calibration.md, section 7, has the equations.

use std::path::Path;

use anyhow::{Context, Result, anyhow, bail, ensure};
use clap::ValueEnum as _;
use posebridge_estimator::models::slow_sensor::SlowSensor;
use posebridge_estimator::numerics::statistics::mean;
use posebridge_lab::identification::{
    DirectionComparison, IdentifiedStep, RunSimilarity, Sampling, StepDirection, StepParameters, TimedSample,
    compare_directions, describe_sensor, estimate_noise, identify_step,
};
use posebridge_report::chart::{Axes, Curve, CurveShape, Plot};
use posebridge_report::report::Report;
use posebridge_telemetry::{Observation, UncertainValue};
use serde_json::{Value, json};

use super::report::{Quantity, end_of_interval, report};
use super::step_dataset::{ChannelName, StepArgs, StepDataset, StepRun, StepTruth, simulated};
use crate::config::SensorSection;
use crate::console::print_line;
use crate::exit::{ExitStage, Failure};
use crate::flags::DataFlags;
use crate::lab::parallel::run_with_bar;
use crate::lab::source::{self, SourceRun};
use crate::tools::dataset::report_skipped;

const STEP_PX: f64 = 280.0;
const REST_PX: f64 = 160.0;
/// Number of plotted samples; more do not fit side by side.
const MAX_PLOTTED_SAMPLES: usize = 600;

pub(super) fn execute(args: &StepArgs) -> Result<(), Failure> {
    let material = load(args).before_start()?;
    let folder = args.output.folder()?;
    let runs: Vec<&StepRun> = material.runs.iter().collect();
    let found = run_with_bar(&runs, "steps", |run| identify_run_step(run)).before_start()?;
    let found: Vec<StepResult<'_>> = found.into_iter().collect::<Result<_>>().while_running()?;
    args.output.write_outcome(&folder, &step_report(&material, &found))?;
    match &args.save {
        Some(path) => save_sensor(args, path, &found).while_running(),
        None => Ok(()),
    }
}

/// Rounding never explains all of the noise.
const MIN_NOISE_SHARE: f64 = 0.1;

fn save_sensor(args: &StepArgs, path: &Path, found: &[StepResult<'_>]) -> Result<()> {
    let steps: Vec<IdentifiedStep> = found.iter().map(|one| one.identified.clone()).collect();
    let similarity = if args.same_sensor { RunSimilarity::SameSensor } else { RunSimilarity::SameKind };
    let dynamics = describe_sensor(&steps, similarity).context("--save: no step shows a lag")?;
    let variance = mean(steps.iter().map(|step| step.sigma * step.sigma)).unwrap_or_default();
    let resolution = args.resolution.unwrap_or(0.0);
    // The noise of the samples has that of rounding in it, which the resolution adds again.
    let rounding_variance = resolution * resolution / 12.0;
    let noise = (variance - rounding_variance).max(MIN_NOISE_SHARE * variance).sqrt();
    let sensor = SlowSensor { dynamics, noise, resolution };
    let section = SensorSection::from_sensor(&sensor).context("--save: no step shows a lag")?;
    section.checked().context("--save")?;
    let names: Vec<&str> = found.iter().map(|one| one.run.name.as_str()).collect();
    let text = format!(
        "# A slow sensor, identified from {}, for `posebridge run --sensor` (docs/lab/thermometer.md).\n{}",
        names.join(", "),
        toml::to_string(&section)?
    );
    std::fs::write(path, text).with_context(|| format!("writing `{}`", path.display()))?;
    print_line(&format!("wrote {}", path.display()));
    Ok(())
}

fn identify_run_step(run: &StepRun) -> Result<StepResult<'_>> {
    let identified = identify_step(&run.samples, &run.options).with_context(|| {
        format!("run `{}`; cut the step out with --from and --to, or give its noise with --noise", run.name)
    })?;
    let numbers = StepParameters::from_step(&identified, run.options.input_step, run.sampling);
    Ok(StepResult { run, identified, numbers })
}

pub(super) fn load(args: &StepArgs) -> Result<StepDataset> {
    check(args)?;
    let Some(path) = &args.recording else {
        ensure!(args.columns.is_default(), "--time-column, --time-unit and --value-column belong to a --recording");
        return simulated(args);
    };
    let end = path.extension().and_then(|end| end.to_str()).unwrap_or("");
    match end {
        "csv" | "txt" => load_table(args, path),
        "toml" | "mcap" => load_recording(args, path),
        _ => bail!("`{}` is no descriptor (*.toml), no recording (*.mcap) and no table (*.csv)", path.display()),
    }
}

fn check(args: &StepArgs) -> Result<()> {
    end_of_interval(args.from, args.to)?;
    if args.save.is_some() {
        ensure!(
            args.recording.is_some() && args.channel.is_none_or(|channel| channel == ChannelName::Temperature),
            "--save writes what is known of a thermometer: give a --recording of one, without another --channel"
        );
        let is_step = args.resolution.is_none_or(|step| step.is_finite() && step >= 0.0);
        ensure!(is_step, "--resolution must be zero or more");
    }
    for (flag, value) in [("--noise", args.noise), ("--input-step", args.input_step)] {
        if let Some(value) = value {
            let is_usable = value.is_finite() && (value > 0.0 || (value < 0.0 && flag != "--noise"));
            ensure!(is_usable, "{flag} is {value}: give a number other than zero");
        }
    }
    Ok(())
}

/// Rejects an onset further from the samples than their own length; one before the first sample may be that of a command that started
/// the recording.
fn check_onset(args: &StepArgs, name: &str, samples: &[TimedSample]) -> Result<()> {
    let (Some(onset_s), [first, .., last]) = (args.onset, samples) else {
        return Ok(());
    };
    let duration_s = last.at_s - first.at_s;
    ensure!(
        (-duration_s..=duration_s).contains(&onset_s),
        "--onset is {onset_s}: the samples of `{name}` end {duration_s} s after the first; give seconds after the first sample"
    );
    Ok(())
}

/// Samples with times since the first one, limited by --from and --to.
fn crop(args: &StepArgs, samples: &[TimedSample]) -> Vec<TimedSample> {
    let first_s = samples.first().map_or(0.0, |sample| sample.at_s);
    let until_s = args.to.unwrap_or(f64::INFINITY);
    let since = samples.iter().map(|sample| TimedSample { at_s: sample.at_s - first_s, value: sample.value });
    since.filter(|sample| args.from <= sample.at_s && sample.at_s <= until_s).collect()
}

fn load_recording(args: &StepArgs, path: &Path) -> Result<StepDataset> {
    let is_descriptor = path.extension().is_some_and(|end| end == "toml");
    ensure!(
        args.columns.is_default(),
        "--time-column, --time-unit and --value-column belong to a table (*.csv); choose a sensor with --channel"
    );
    let flags = DataFlags {
        data: args.data.clone(),
        // Every name begins with nothing: all runs.
        run: args.run.clone().or(is_descriptor.then(String::new)),
        use_every: None,
        settings: args.settings.clone(),
    };
    let drives = source::load(path, &flags)?;
    let channel_name = args.channel.unwrap_or(ChannelName::Temperature);
    let channel = channel_name.channel();
    let mut runs = Vec::new();
    for drive in &drives.runs {
        for part in parts(channel_name, drive)? {
            runs.push(run_from_part(args, channel_name, &part)?);
        }
    }
    Ok(StepDataset {
        source: drives.recording,
        sensor: channel.name().to_owned(),
        unit: channel.unit(),
        gain_unit: "",
        runs,
    })
}

struct StepPart<'a> {
    name: String,
    drive: &'a SourceRun,
    observations: &'a [Observation],
}

/// Each thermometer of a posebridge recording separately; else the whole drive, which has each sensor once.
fn parts(channel_name: ChannelName, drive: &SourceRun) -> Result<Vec<StepPart<'_>>> {
    if channel_name != ChannelName::Temperature || drive.thermometers.is_empty() {
        return Ok(vec![StepPart { name: drive.name.clone(), drive, observations: &drive.observations }]);
    }
    let parts = drive.thermometers.iter().map(|one| {
        let name = format!("{} {}", drive.name, one.name_among(&drive.thermometers));
        let readings = one.readings();
        Ok(StepPart { observations: readings.with_context(|| format!("recording `{}`", drive.name))?, name, drive })
    });
    parts.collect()
}

fn run_from_part(args: &StepArgs, channel_name: ChannelName, part: &StepPart<'_>) -> Result<StepRun> {
    let all = channel_name.channel().samples(part.observations);
    report_skipped(&part.name, channel_name.channel().excluded_count(part.observations));
    check_onset(args, &part.name, &all)?;
    let samples = crop(args, &all);
    if samples.is_empty() {
        let others = ChannelName::value_variants().iter();
        let others: Vec<String> = others
            .filter(|one| !crop(args, &one.channel().samples(part.observations)).is_empty())
            .filter_map(|one| Some(one.to_possible_value()?.get_name().to_owned()))
            .collect();
        bail!(
            "run `{}` holds no {} there; what it holds for --channel: {}",
            part.name,
            channel_name.channel().name(),
            if others.is_empty() { "nothing".to_owned() } else { others.join(", ") }
        );
    }
    let (noise, geometry) = (&part.drive.config.noise, &part.drive.config.geometry);
    let sigma = channel_name.channel().noise(noise, geometry, &samples);
    Ok(StepRun { sampling: channel_name.channel().sampling(), ..run_from_samples(args, &part.name, samples, sigma)? })
}

fn run_from_samples(args: &StepArgs, name: &str, samples: Vec<TimedSample>, sigma: Option<f64>) -> Result<StepRun> {
    let sigma = args.noise.or(sigma).ok_or_else(|| {
        anyhow!("`{name}`: its {} samples do not say how noisy they are; give --noise", samples.len())
    })?;
    Ok(StepRun {
        name: name.to_owned(),
        samples,
        options: args.options(sigma),
        sampling: Sampling::Readings,
        truth: None,
    })
}

fn load_table(args: &StepArgs, path: &Path) -> Result<StepDataset> {
    ensure!(
        args.channel.is_none() && args.run.is_none(),
        "--channel and --run choose from a recording; name a table's columns with --time-column and --value-column"
    );
    ensure!(
        args.settings.is_empty(),
        "--set changes what a recording says of its robot; a table says nothing of one. Give the noise of its samples with --noise"
    );
    let name = path.display().to_string();
    let table = args.columns.read(path)?;
    check_onset(args, &name, &table.samples)?;
    let samples = crop(args, &table.samples);
    let sigma = estimate_noise(&samples);
    Ok(StepDataset {
        runs: vec![run_from_samples(args, &name, samples, sigma)?],
        source: name,
        sensor: table.value_column,
        unit: "",
        gain_unit: "",
    })
}

struct StepResult<'a> {
    run: &'a StepRun,
    identified: IdentifiedStep,
    numbers: StepParameters,
}

fn step_report(material: &StepDataset, found: &[StepResult<'_>]) -> Report {
    let lags = found.iter().map(|one| (direction_of(one), one.numbers.mean_lag_s));
    let compared = compare_directions(&lags.collect::<Vec<_>>());
    let mut notes: Vec<String> = found.iter().map(note).collect();
    notes.extend(compared.map(|directions| direction_note(&directions)));
    let quantities: Vec<Quantity> = found.iter().flat_map(|one| quantities(material, one)).collect();
    let plots: Vec<Plot> = found.iter().map(|one| picture(material, one)).collect();
    let title = format!("Step response: {}", material.sensor);
    let mut report = report("identify-step", &title, &material.source, &quantities, &notes, &plots);
    report.data("sensor", json!(material.sensor));
    report.data("runs", found.iter().map(run_object).collect());
    let directions = compared.map(|directions| {
        json!({
            "up_s": uncertain_value_json(directions.up),
            "down_s": uncertain_value_json(directions.down),
            "z": directions.z,
            "differ": directions.differ(),
        })
    });
    report.data("ways", json!(directions));
    report
}

fn direction_of(found: &StepResult<'_>) -> StepDirection {
    StepDirection::from_step(found.identified.response().step)
}

fn quantities(material: &StepDataset, found: &StepResult<'_>) -> Vec<Quantity> {
    let (numbers, truth) = (&found.numbers, found.run.truth.as_ref());
    let quantity = |name: &str, unit: &'static str, known: UncertainValue| {
        Quantity::new(name, unit, known.value, known.sigma).for_run(found.run.name.clone())
    };
    let mut all = vec![
        Quantity::new("order", "1", found.identified.order() as f64, None)
            .for_run(found.run.name.clone())
            .with_truth(truth.map(|truth| truth.lags.len() as f64)),
    ];
    all.extend(
        numbers.gain.map(|gain| quantity("gain", material.gain_unit, gain).with_truth(truth.map(|truth| truth.gain))),
    );
    all.extend(numbers.delay_s.map(|delay| quantity("dead time", "s", delay).with_truth(truth.map(|one| one.delay_s))));
    for (j, lag) in numbers.lags.iter().enumerate() {
        let own = true_lag(truth, numbers.lags.len(), j);
        let tau = UncertainValue { value: lag.time_constant_s, sigma: lag.time_constant_sigma_s };
        let tau = quantity(&format!("time constant {}", j + 1), "s", tau);
        all.push(tau.with_truth(own.map(|(tau_s, _)| tau_s)));
        if numbers.lags.len() > 1 {
            let share = UncertainValue { value: lag.share, sigma: lag.share_sigma };
            let share = quantity(&format!("share {}", j + 1), "1", share);
            all.push(share.with_truth(own.map(|(_, share)| share)));
        }
    }
    let mean_lag = truth.map(|truth| truth.lags.iter().map(|(tau_s, share)| tau_s * share).sum::<f64>());
    all.push(quantity("mean lag", "s", numbers.mean_lag_s).with_truth(mean_lag));
    all.push(quantity("step", material.unit, numbers.step));
    all.push(quantity("end", material.unit, numbers.end));
    all
}

/// The true lag, if the identified order is the true one.
fn true_lag(truth: Option<&StepTruth>, order: usize, j: usize) -> Option<(f64, f64)> {
    let lags = &truth?.lags;
    (lags.len() == order).then(|| lags.get(j).copied())?
}

fn note(found: &StepResult<'_>) -> String {
    let StepResult { run, identified, numbers } = found;
    let by_order: Vec<String> = identified
        .candidates
        .iter()
        .map(|candidate| {
            let order = candidate.fit.response.lags.len();
            let is_resolved = IdentifiedStep::is_resolved(candidate);
            let remark = if is_resolved { "" } else { ", not told apart" };
            format!("{order}: {:.1}{remark}", candidate.criterion)
        })
        .collect();
    format!(
        "{}: {}, {} samples of noise {:.4}; residual {:.4}, rho(1) {:+.2}; criterion by order, the least is best: {}",
        run.name,
        direction_of(found).name(),
        identified.samples.len(),
        identified.sigma,
        numbers.residual_rms,
        numbers.rho_1,
        by_order.join("; ")
    )
}

fn direction_note(directions: &DirectionComparison) -> String {
    let verdict = if directions.differ() {
        "they differ: identify and predict each way by its own"
    } else {
        "no difference is shown"
    };
    format!(
        "mean lag up {:.4} ± {:.4} s, down {:.4} ± {:.4} s, {:+.1} sigma apart: {verdict}",
        directions.up.value, directions.up.sigma, directions.down.value, directions.down.sigma, directions.z
    )
}

fn uncertain_value_json(known: UncertainValue) -> Value {
    json!({ "value": known.value, "sigma": known.sigma })
}

fn run_object(found: &StepResult<'_>) -> Value {
    let candidates = found.identified.candidates.iter().map(|candidate| {
        json!({
            "order": candidate.fit.response.lags.len(),
            "criterion": candidate.criterion,
            "residual_rms": candidate.residual_rms,
            "resolved": IdentifiedStep::is_resolved(candidate),
        })
    });
    json!({
        "name": found.run.name,
        "way": direction_of(found).name(),
        "order": found.identified.order(),
        "samples": found.identified.samples.len(),
        "noise": found.identified.sigma,
        "residual_rms": found.numbers.residual_rms,
        "rho_1": found.numbers.rho_1,
        "candidates": candidates.collect::<Vec<_>>(),
    })
}

fn picture(material: &StepDataset, found: &StepResult<'_>) -> Plot {
    let samples = &found.identified.samples;
    let response = found.identified.response();
    let every = samples.len().div_ceil(MAX_PLOTTED_SAMPLES).max(1);
    let by = |of: &dyn Fn(f64, f64) -> f64| -> Vec<(f64, f64)> {
        let drawn = samples.iter().step_by(every);
        drawn.map(|sample| (sample.at_s, of(sample.at_s, sample.value))).collect()
    };
    let unit = if material.unit.is_empty() { String::new() } else { format!(" [{}]", material.unit) };
    let lags: Vec<String> = found
        .numbers
        .lags
        .iter()
        .map(|lag| format!("{:.4} ± {:.4} s", lag.time_constant_s, lag.time_constant_sigma_s))
        .collect();
    let above = [
        Curve::dots("samples", by(&|_, value| value)),
        Curve::line("response", by(&|at_s, _| response.value_at(at_s))),
    ];
    let below = [
        Curve::dots("sample - response", by(&|at_s, value| value - response.value_at(at_s))),
        Curve::new("zero", CurveShape::Level(0.0)),
    ];
    Plot::new(
        format!("{}: {}", material.sensor, found.run.name),
        format!("time constants {}", lags.join(", ")),
        vec![
            Axes::new("time [s]", format!("{}{unit}", material.sensor), STEP_PX, above),
            Axes::new("time [s]", format!("left{unit}"), REST_PX, below),
        ],
    )
}
