//! `posebridge lab thermometer`: what a slow sensor will show in the end, told while it is on its way (paper 2).
//!
//! Without `--recording` on a simulated sensor, section by section; with it on recorded steps. docs/lab/thermometer.md is its page.

mod recording;

use std::path::PathBuf;

use clap::Args;
use posebridge_analysis::figures::plot;
use posebridge_analysis::identification::lesson::{SECTIONS, Section, bound_run, bounds};
use posebridge_analysis::report::page::{Page, Part};
use serde_json::{Map, Value, json};

use super::live::LiveArgs;
use super::outcome::{Outcome, OutputArgs};
use crate::commands::{Failure, Stage};
use crate::config::Setting;
use crate::parallel::run_all;
use crate::progress;

/// Flags of `lab thermometer`.
#[derive(Args, Clone, Debug)]
#[command(group = clap::ArgGroup::new("real").multiple(true).args(["recordings", "link", "listen"]))]
pub struct LabThermometerArgs {
    /// A descriptor (config/recordings/*.toml) with temperatures, or recordings of ours (*.mcap; each of their thermometers is a run),
    /// instead of the simulated sensor.
    #[arg(long = "recording", value_name = "FILE", num_args = 1..)]
    pub recordings: Vec<PathBuf>,
    /// A live robot, whose step the recordings foretell.
    #[command(flatten)]
    pub live: LiveArgs,
    /// Where the descriptor's relative paths start; else POSEBRIDGE_DATA, else the descriptor's own folder.
    #[arg(long, value_name = "DIR", env = "POSEBRIDGE_DATA")]
    pub data: Option<PathBuf>,
    /// Runs to identify the sensor on; without it all.
    #[arg(long, value_name = "RUN", num_args = 1.., requires = "real")]
    pub identify: Vec<String>,
    /// Runs to predict, each by the identified ones without itself; without it all.
    #[arg(long, value_name = "RUN", num_args = 1.., requires = "real")]
    pub predict: Vec<String>,
    /// The runs are of one sensor in the same surroundings: a step the same way has the very same dynamics.
    #[arg(long, requires = "real")]
    pub same_sensor: bool,
    /// Set one key of a descriptor's robot, or of the configuration of a recording or a live robot, e.g.
    /// robot.noise.temperature_k=0.05; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE", value_parser = Setting::parse, requires = "real")]
    pub settings: Vec<Setting>,
    /// Runs over which the bounds of the simulated sensor are counted.
    #[arg(long, value_name = "N", default_value_t = 1_000, conflicts_with = "real", value_parser = clap::value_parser!(u32).range(10..=100_000))]
    pub runs: u32,
    /// Seed of the simulated sensor.
    #[arg(long, value_name = "N", default_value_t = 1, conflicts_with = "real")]
    pub seed: u64,
    /// What it leaves behind.
    #[command(flatten)]
    pub output: OutputArgs,
}

impl LabThermometerArgs {
    fn is_real(&self) -> bool {
        !self.recordings.is_empty() || self.live.is_asked()
    }
}

/// Runs the experiment.
///
/// # Errors
/// The recording or a run of it cannot be used, or an output cannot be written.
pub fn execute(args: &LabThermometerArgs) -> Result<(), Failure> {
    let folder = args.output.folder()?;
    let sections = if args.is_real() { recording::sections(args)? } else { simulated(args)? };
    args.output.deliver(&folder, &outcome(args, &sections))
}

/// A part of the work on the simulated sensor.
enum Job {
    /// A section, by its index.
    Section(usize),
    /// A run for the bounds, by its number.
    Bound(u64),
}

/// What a job gives back.
enum Done {
    Section(Box<Section>),
    Bound(posebridge_analysis::identification::lesson::BoundRun),
}

fn simulated(args: &LabThermometerArgs) -> Result<Vec<Section>, Failure> {
    let sections = (0..SECTIONS.len()).map(Job::Section);
    let jobs: Vec<Job> = sections.chain((0..u64::from(args.runs)).map(Job::Bound)).collect();
    let bar = progress::bar(jobs.len() as u64, "parts").at_start()?;
    let run = |job: &Job| match job {
        Job::Section(index) => {
            let section = SECTIONS.get(*index).map(|make| make(args.seed));
            Done::Section(Box::new(section.unwrap_or_default()))
        }
        // Far from the seeds of the sections.
        Job::Bound(run) => Done::Bound(bound_run(args.seed.wrapping_mul(1 << 32).wrapping_add(*run))),
    };
    let mut sections = Vec::new();
    let mut bound_runs = Vec::new();
    for done in run_all(&jobs, run, || bar.inc(1)) {
        match done {
            Done::Section(section) => sections.push(*section),
            Done::Bound(run) => bound_runs.push(run),
        }
    }
    bar.finish_and_clear();
    sections.push(bounds(&bound_runs));
    Ok(sections)
}

fn outcome(args: &LabThermometerArgs, sections: &[Section]) -> Outcome {
    let source = if args.is_real() {
        let names = args.recordings.iter().map(|path| path.display().to_string());
        let live = args.live.is_asked().then(|| "a live robot".to_owned());
        let names: Vec<String> = names.chain(live).collect();
        format!("recording {}", names.join(", "))
    } else {
        format!("simulated sensor, seed {}", args.seed)
    };
    let mut parts = vec![Part::Text(format!(
        "What will a slow sensor show in the end? Source: {source}. docs/lab/thermometer.md has the theory and exercises."
    ))];
    parts.extend(sections.iter().flat_map(parts_of));
    Outcome {
        name: "lab-thermometer",
        page: Page { title: "The slow thermometer".to_owned(), parts },
        text: sections.iter().map(text_of).collect(),
        json: json_of(&source, sections),
    }
}

fn parts_of(section: &Section) -> Vec<Part> {
    let mut parts = vec![Part::Heading(section.title.clone())];
    parts.extend(section.words.iter().cloned().map(Part::Text));
    if !section.header.is_empty() {
        parts.push(Part::Table { header: section.header.clone(), rows: section.rows.clone() });
    }
    parts.extend(
        section.picture.iter().map(|(picture, caption)| Part::Figure { svg: plot(picture), caption: caption.clone() }),
    );
    parts
}

/// The section's table for the terminal; nothing for a section that is a picture only.
fn text_of(section: &Section) -> String {
    if section.header.is_empty() {
        return String::new();
    }
    let all = || std::iter::once(&section.header).chain(&section.rows);
    let width = |column: usize| {
        let cells = all().filter_map(|row| row.get(column));
        cells.map(|cell| cell.chars().count()).max().unwrap_or(0)
    };
    let widths: Vec<usize> = (0..section.header.len()).map(width).collect();
    let line = |row: &Vec<String>| {
        let cells = row.iter().zip(&widths);
        let cells: Vec<String> = cells.map(|(cell, width)| format!("{cell:<width$}")).collect();
        cells.join("  ").trim_end().to_owned() + "\n"
    };
    let rows: String = all().map(line).collect();
    format!("{}\n{rows}\n", section.title)
}

/// `{"source", "sections": {name: {number: value}}}`; a figure that cannot be had is null.
fn json_of(source: &str, sections: &[Section]) -> Value {
    let of = |section: &Section| {
        let numbers = section.numbers.iter();
        let numbers: Map<String, Value> = numbers.map(|(name, value)| (name.clone(), json!(value))).collect();
        (section.name.to_owned(), Value::Object(numbers))
    };
    let with_numbers = sections.iter().filter(|section| !section.numbers.is_empty());
    let all: Map<String, Value> = with_numbers.map(of).collect();
    json!({"source": source, "sections": all})
}
