//! `posebridge lab thermometer`: what a slow sensor will show in the end, told while it is on its way (paper 2).
//!
//! Without `--recording` on a simulated sensor, section by section; with it on recorded steps. docs/lab/thermometer.md is its page.

mod args;
mod recording;

use posebridge_lab::identification::lesson::{LessonSection, SECTIONS, bound_run, bounds_section};
use posebridge_report::report::{Report, Table};
use serde_json::{Map, Value, json};

pub use self::args::LabThermometerArgs;
use crate::console::progress_bar;
use crate::exit::{ExitStage, Failure};
use crate::lab::parallel::run_all;

/// Runs the experiment.
///
/// # Errors
/// The recording or a run of it cannot be used, or an output cannot be written.
pub fn execute(args: &LabThermometerArgs) -> Result<(), Failure> {
    let folder = args.output.folder()?;
    let sections = if args.is_real() { recording::sections(args)? } else { simulated(args)? };
    args.output.write_outcome(&folder, &report(args, &sections))
}

/// A part of the work on the simulated sensor.
enum ThermometerJob {
    /// A section, by its index.
    Section(usize),
    /// A run for the bounds, by its number.
    Bound(u64),
}

/// What a job gives back.
enum ThermometerOutput {
    Section(Box<LessonSection>),
    Bound(posebridge_lab::identification::lesson::BoundRun),
}

fn simulated(args: &LabThermometerArgs) -> Result<Vec<LessonSection>, Failure> {
    let sections = (0..SECTIONS.len()).map(ThermometerJob::Section);
    let jobs: Vec<ThermometerJob> = sections.chain((0..u64::from(args.runs)).map(ThermometerJob::Bound)).collect();
    let bar = progress_bar(jobs.len() as u64, "parts").before_start()?;
    let run = |job: &ThermometerJob| match job {
        ThermometerJob::Section(index) => {
            let section = SECTIONS.get(*index).map(|make| make(args.seed));
            ThermometerOutput::Section(Box::new(section.unwrap_or_default()))
        }
        // Far from the seeds of the sections.
        ThermometerJob::Bound(run) => {
            ThermometerOutput::Bound(bound_run(args.seed.wrapping_mul(1 << 32).wrapping_add(*run)))
        }
    };
    let mut sections = Vec::new();
    let mut bound_runs = Vec::new();
    for done in run_all(&jobs, run, || bar.inc(1)) {
        match done {
            ThermometerOutput::Section(section) => sections.push(*section),
            ThermometerOutput::Bound(run) => bound_runs.push(run),
        }
    }
    bar.finish_and_clear();
    sections.push(bounds_section(&bound_runs));
    Ok(sections)
}

fn report(args: &LabThermometerArgs, sections: &[LessonSection]) -> Report {
    let source = if args.is_real() {
        let names = args.recordings.iter().map(|path| path.display().to_string());
        let live = args.live.is_requested().then(|| "a live robot".to_owned());
        let names: Vec<String> = names.chain(live).collect();
        format!("recording {}", names.join(", "))
    } else {
        format!("simulated sensor, seed {}", args.seed)
    };
    let mut report = Report::new("lab-thermometer", "The slow thermometer");
    report.background("What will a slow sensor show in the end? docs/lab/thermometer.md has the theory and exercises.");
    report.paragraph(format!("Source: {source}"));
    for section in sections {
        add_section(&mut report, section);
    }
    report.data("source", json!(source));
    report.data("sections", sections_json(sections));
    report
}

fn add_section(report: &mut Report, section: &LessonSection) {
    report.heading(section.title.as_str());
    for paragraph in &section.paragraphs {
        report.background(paragraph);
    }
    if !section.header.is_empty() {
        let mut table = Table::of(&section.rows);
        for (column, heading) in section.header.iter().enumerate() {
            table = table.text("", heading, move |row| row.get(column).cloned().unwrap_or_default());
        }
        report.table("", &table);
    }
    if let Some((plot, caption)) = &section.figure {
        report.chart(plot, caption);
    }
}

/// `{name: {number: value}}` of the sections that have numbers; a figure that cannot be had is null.
fn sections_json(sections: &[LessonSection]) -> Value {
    let of = |section: &LessonSection| {
        let numbers = section.values.iter();
        let numbers: Map<String, Value> = numbers.map(|(name, value)| (name.clone(), json!(value))).collect();
        (section.name.to_owned(), Value::Object(numbers))
    };
    let with_numbers = sections.iter().filter(|section| !section.values.is_empty());
    Value::Object(with_numbers.map(of).collect())
}
