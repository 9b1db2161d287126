//! The page of a session: verdict first, then path, errors, sensors, what was learned, links, clock, and what happened.

use std::fmt::Write as _;

use posebridge_analysis::RunLayers;
use posebridge_analysis::figures::session::{
    self, InnovationSeries, LearnedSeries, clock, errors, innovations, learning, link, shown_unit,
};
use posebridge_analysis::report::NO_VALUE;
use posebridge_analysis::report::page::{Page, Part, Picture};

use super::chronicle::Chronicle;
use super::story::{RunStory, SourceVerdict, Story, Yardstick};
use crate::config::CALIBRATION_KEYS;

/// The page.
#[must_use]
pub fn page(story: &Story) -> Page {
    let mut parts = summary(story);
    for (index, run) in story.runs.iter().enumerate() {
        parts.extend(run_parts(story, run, index));
    }
    parts.push(Part::Text(format!(
        "Made by posebridge {} from the recorded inputs alone, by the engine that runs live.",
        env!("CARGO_PKG_VERSION")
    )));
    Page { title: format!("Report of {}", story.recording), parts }
}

fn summary(story: &Story) -> Vec<Part> {
    let mut rows: Vec<Vec<String>> =
        story.facts.iter().map(|(name, value)| vec![name.clone(), value.clone()]).collect();
    rows.push(vec!["filter".to_owned(), story.filter.clone()]);
    let mut parts = vec![Part::Listing { header: vec!["recording".to_owned(), story.recording.clone()], rows }];
    if !story.changed.is_empty() {
        parts.push(Part::Text(format!("Replayed with {}: this is not what ran.", story.changed.join(", "))));
    }
    if !story.notes.is_empty() {
        parts.push(Part::List(story.notes.clone()));
    }
    parts
}

fn run_parts(story: &Story, run: &RunStory, index: usize) -> Vec<Part> {
    let mut parts = Vec::new();
    if story.runs.len() > 1 {
        parts.push(Part::Heading(format!("Run {}", run.name)));
    }
    let (tone, word, text) = run.verdict();
    parts.push(Part::Verdict { tone, word: word.to_owned(), text });
    parts.push(Part::Text(in_figures(run)));
    parts.push(Part::Pictures(main_pictures(run, index)));
    parts.extend(source_parts(run, index));
    parts.extend(learned_parts(run, index));
    parts.extend(link_parts(run, index));
    parts.extend(happenings(&run.chronicle));
    parts
}

/// How long, how many, how far off: in one sentence each.
fn in_figures(run: &RunStory) -> String {
    let chronicle = &run.chronicle;
    let mut text =
        format!("{:.1} s, {} observations.", chronicle.length().as_secs_f64(), chronicle.collector.observations);
    let errors = &run.errors;
    if let (Some(rms_m), Some(max_m), Some(end_m)) =
        (errors.position_rms_m, errors.position_max_m, errors.position_end_m)
    {
        // Writing to a String cannot fail.
        let _ = write!(
            text,
            " Against {} the position is {} mm off (root mean square), at most {} mm, at the end {} mm.",
            run.yardstick.in_words(),
            millimetres(rms_m),
            millimetres(max_m),
            millimetres(end_m)
        );
    }
    if let Some(heading_rad) = errors.heading_rms_rad {
        // Writing to a String cannot fail.
        let _ = write!(text, " The heading is {:.2} degrees off.", heading_rad.to_degrees());
    }
    if let Some(anees) = errors.anees {
        let _ = write!(text, " ANEES {anees:.2}: 1 is honest, more is too sure.");
    }
    if run.yardstick == Yardstick::None {
        text += " No truth is known: errors cannot be told.";
    }
    text
}

fn millimetres(length_m: f64) -> String {
    format!("{:.1}", length_m * 1e3)
}

fn picture(index: usize, name: &str, svg: String, caption: &str) -> Picture {
    Picture { name: format!("run{}-{name}", index + 1), svg, caption: caption.to_owned() }
}

fn main_pictures(run: &RunStory, index: usize) -> Vec<Picture> {
    let collector = &run.chronicle.collector;
    let estimates = run.chronicle.estimates();
    let layers = RunLayers {
        title: &run.name,
        truth: run.truth.as_ref(),
        odometry: run.odometry.as_ref(),
        estimates: &estimates,
        fixes: collector.fixes.items(),
        ..RunLayers::default()
    };
    let mut pictures = vec![picture(
        index,
        "path",
        session::path(&layers),
        "The path. An ellipse holds the robot in 95 of 100 cases, if the claims are honest.",
    )];
    if let Some(truth) = &run.truth {
        pictures.push(picture(
            index,
            "errors",
            errors("Error of the estimate", &run.chronicle.errors(truth)),
            "How far the estimate was from the truth, and twice the standard deviation that it claimed.",
        ));
    }
    pictures
}

fn source_parts(run: &RunStory, index: usize) -> Vec<Part> {
    let verdicts = run.verdicts();
    if verdicts.is_empty() {
        return Vec::new();
    }
    let mut parts = vec![Part::Subheading("Sensors".to_owned())];
    for one in &verdicts {
        parts.push(Part::Verdict {
            tone: one.judgement.tone(),
            word: format!("{}:", one.sensor.name()),
            text: one.judgement.to_string(),
        });
    }
    let header = [
        "sensor",
        "used",
        "slip",
        "gated",
        "too late",
        "malformed",
        "re-based",
        "reset to",
        "unused",
        "NIS/dof",
        "dof",
        "correlation",
    ];
    parts.push(Part::table(&header, verdicts.iter().map(source_row).collect()));
    let predicted = run.chronicle.sources.iter().filter(|source| !source.samples.items().is_empty());
    let pictures = predicted.map(|source| {
        let name = source.sensor.name();
        let series = InnovationSeries {
            name: &format!("Innovations: {name}"),
            kind: source.kind,
            samples: source.samples.items(),
        };
        picture(
            index,
            &format!("innovations-{}", name.replace(' ', "-")),
            innovations(&series),
            "Observed minus predicted, with two standard deviations of what was claimed. Below, the normalised square: what lies above \
             the panel is drawn on its edge.",
        )
    });
    let pictures: Vec<Picture> = pictures.collect();
    if !pictures.is_empty() {
        parts.push(Part::Pictures(pictures));
    }
    parts
}

fn source_row(verdict: &SourceVerdict) -> Vec<String> {
    let tally = &verdict.tally;
    let number = |value: Option<f64>| value.map_or_else(|| NO_VALUE.to_owned(), |value| format!("{value:.3}"));
    vec![
        verdict.sensor.name().to_owned(),
        (tally.used + tally.reset_to).to_string(),
        tally.slip.to_string(),
        tally.gated.to_string(),
        tally.too_old.to_string(),
        tally.malformed.to_string(),
        tally.rebased.to_string(),
        tally.reset_to.to_string(),
        tally.unused.to_string(),
        number(tally.mean_nis_per_dof()),
        tally.degrees_of_freedom().to_string(),
        number(verdict.judgement.correlation),
    ]
}

fn learned_parts(run: &RunStory, index: usize) -> Vec<Part> {
    let Some(learned) = &run.learned else {
        return Vec::new();
    };
    let open = CALIBRATION_KEYS.iter().filter(|entry| (entry.read)(&learned.prior).sigma > 0.0);
    let rows: Vec<Vec<String>> = open
        .map(|entry| {
            let (unit, factor) = shown_unit(entry.key);
            let [before, after] = [&learned.prior, &learned.calibration].map(|calibration| {
                let known = (entry.read)(calibration);
                format!("{:.3} ± {:.3}", known.value * factor, known.sigma * factor)
            });
            vec![entry.key.to_owned(), unit.to_owned(), before, after]
        })
        .collect();
    if rows.is_empty() {
        return Vec::new();
    }
    let mut parts = vec![
        Part::Subheading("What was learned of the robot".to_owned()),
        Part::table(&["entry", "unit", "before", "after"], rows),
    ];
    let series: Vec<LearnedSeries<'_>> =
        run.chronicle.learned().map(|story| LearnedSeries { key: story.key, samples: story.samples.items() }).collect();
    if !series.is_empty() {
        parts.push(Part::Pictures(vec![picture(
            index,
            "learned",
            learning("Learned", &series),
            "What was believed of each systematic error, with two standard deviations.",
        )]));
    }
    parts
}

fn link_parts(run: &RunStory, index: usize) -> Vec<Part> {
    let chronicle = &run.chronicle;
    let mut pictures: Vec<Picture> = chronicle
        .links
        .iter()
        .map(|(id, samples)| {
            picture(
                index,
                &format!("link-{id}"),
                link(&format!("Link {id}"), samples.items()),
                "What came and left per second; what never happened is not shown.",
            )
        })
        .collect();
    if !chronicle.clock.items().is_empty() {
        pictures.push(picture(
            index,
            "clock",
            clock("The brick's clock", chronicle.clock.items()),
            "Brick time less host time, and how far it may be off.",
        ));
    }
    if pictures.is_empty() {
        return Vec::new();
    }
    vec![Part::Subheading("Links and clock".to_owned()), link_table(chronicle), Part::Pictures(pictures)]
}

fn link_table(chronicle: &Chronicle) -> Part {
    let links = chronicle.collector.links.iter();
    let header = [
        "link",
        "received",
        "sent",
        "lost",
        "damaged",
        "garbage bytes",
        "stalls",
        "not sent",
        "reconnects",
        "round trip [ms]",
    ];
    let rows = links.map(|(id, report)| {
        let health = &report.health;
        let round_trip = health.round_trip;
        vec![
            id.to_string(),
            health.frames_in.to_string(),
            health.frames_out.to_string(),
            health.frames_lost.to_string(),
            health.checksum_errors.to_string(),
            health.garbage_bytes.to_string(),
            health.stalls.to_string(),
            (health.drops_out + health.port.drops_out).to_string(),
            health.reconnects.to_string(),
            round_trip.map_or_else(|| NO_VALUE.to_owned(), |span| format!("{:.1}", span.as_millis_f64())),
        ]
    });
    Part::table(&header, rows.collect())
}

fn happenings(chronicle: &Chronicle) -> Vec<Part> {
    let all = &chronicle.happenings;
    if all.all.is_empty() {
        return Vec::new();
    }
    let rows = all.all.iter().map(|one| vec![format!("{:.2}", one.t_s), one.what.clone()]);
    let mut rows: Vec<Vec<String>> = rows.collect();
    if all.more > 0 {
        rows.push(vec![String::new(), format!("and {} more", all.more)]);
    }
    vec![
        Part::Subheading("What happened".to_owned()),
        Part::Listing { header: vec!["time [s]".to_owned(), "what".to_owned()], rows },
    ]
}
