//! `posebridge identify step`: gain, dead time and lags of a sensor or a motor, from the samples of one step or several.
//!
//! Without a recording on a simulated sensor with known parameters. docs/lab/calibration.md, section 7, has the equations.

use std::path::Path;

use anyhow::{Context, Result, anyhow, bail, ensure};
use posebridge_lab::identification::{
    Sampling, StepParameters, TimedSample, estimate_noise, identify_step, sorted_by_time,
};
use posebridge_telemetry::Observation;

use super::findings::report;
use super::step_dataset::{ChannelName, StepArgs, StepDataset, StepRun, TimeUnit};
use super::step_report::StepResult;
use super::{step_report, step_simulated};
use crate::console::print_line;
use crate::exit::{ExitStage, Failure};
use crate::flags::DataFlags;
use crate::lab::calibrate::source::{self, CalibrationDrive, ReferenceSettings};
use crate::lab::parallel::run_with_bar;
use crate::tools::csv_table::CsvTable;
use crate::tools::dataset::report_skipped;

pub(super) fn execute(args: &StepArgs) -> Result<(), Failure> {
    let material = load(args).before_start()?;
    let folder = args.output.folder()?;
    let found = run_with_bar(&material.runs, "steps", identify_run_step).before_start()?;
    let found: Vec<StepResult> = found.into_iter().collect::<Result<_>>().while_running()?;
    let findings = step_report::findings(&material, &found);
    args.output.write_outcome(&folder, &report(&findings, &material.source))
}

fn identify_run_step(run: &StepRun) -> Result<StepResult> {
    let identified = identify_step(&run.samples, &run.options).with_context(|| {
        format!("run `{}`; cut the step out with --from and --to, or give its noise with --noise", run.name)
    })?;
    Ok(StepResult {
        numbers: StepParameters::from_step(&identified, run.options.input_step, run.sampling),
        identified,
        run: run.clone(),
    })
}

pub(super) fn load(args: &StepArgs) -> Result<StepDataset> {
    check(args)?;
    let Some(path) = &args.recording else {
        return step_simulated::material(args);
    };
    let end = path.extension().and_then(|end| end.to_str()).unwrap_or("");
    match end {
        "csv" | "txt" => load_table(args, path),
        "toml" | "mcap" => load_recording(args, path),
        _ => bail!("`{}` is no descriptor (*.toml), no recording (*.mcap) and no table (*.csv)", path.display()),
    }
}

fn check(args: &StepArgs) -> Result<()> {
    let until_s = args.to.unwrap_or(f64::INFINITY);
    ensure!(args.from < until_s, "--from is {} and --to is {until_s}: nothing lies between them", args.from);
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
        args.time_column.is_none() && args.value_column.is_none() && args.time_unit.is_none(),
        "--time-column, --time-unit and --value-column belong to a table (*.csv); choose a sensor with --channel"
    );
    let flags = DataFlags {
        data: args.data.clone(),
        // Every name begins with nothing: all runs. A recording of ours has one.
        run: is_descriptor.then(|| args.run.clone().unwrap_or_default()),
        use_every: None,
        settings: args.settings.clone(),
    };
    ensure!(is_descriptor || args.run.is_none(), "--run chooses from a descriptor's runs; a recording of ours has one");
    let watch = ReferenceSettings { reference: None, truth_sigma_m: 1.0 };
    let drives = source::load(path, &flags, watch).map_err(|failure| match failure {
        Failure::CouldNotStart(error) | Failure::Failed(error) => error,
    })?;
    let channel_name = args.channel.unwrap_or(ChannelName::Temperature);
    let channel = channel_name.channel();
    let mut runs = Vec::new();
    for drive in &drives.drives {
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
    drive: &'a CalibrationDrive,
    observations: &'a [Observation],
}

/// Each thermometer of a posebridge recording separately; else the whole drive, which has each sensor once.
fn parts(channel_name: ChannelName, drive: &CalibrationDrive) -> Result<Vec<StepPart<'_>>> {
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
        let others = ChannelName::ALL.into_iter();
        let others: Vec<&str> = others
            .filter(|one| !crop(args, &one.channel().samples(part.observations)).is_empty())
            .map(ChannelName::flag)
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
    let unit = args.time_unit.unwrap_or(TimeUnit::S);
    let listing = CsvTable::read(path)?;
    let column = |requested: &Option<String>, position: usize, flag: &str| {
        let named = requested.clone().or_else(|| listing.columns().get(position).map(str::to_owned));
        named.with_context(|| format!("`{}` has no column for {flag}", path.display()))
    };
    let time = column(&args.time_column, 0, "--time-column")?;
    let value = column(&args.value_column, 1, "--value-column")?;
    let samples: Vec<TimedSample> = listing
        .rows()
        .map(|row| Ok(TimedSample { at_s: row.number(&time)? * unit.seconds(), value: row.number(&value)? }))
        .collect::<Result<_>>()?;
    let name = path.display().to_string();
    let ordered = sorted_by_time(&samples);
    if samples.windows(2).any(|pair| pair[1].at_s < pair[0].at_s) {
        print_line(&format!(
            "{name}: some of its rows are earlier than the row before; all were put into the order of `{time}`"
        ));
    }
    report_skipped(&name, samples.len() - ordered.len());
    check_onset(args, &name, &ordered)?;
    let samples = crop(args, &ordered);
    let sigma = estimate_noise(&samples);
    Ok(StepDataset {
        runs: vec![run_from_samples(args, &name, samples, sigma)?],
        source: name,
        sensor: value,
        unit: "",
        gain_unit: "",
    })
}
