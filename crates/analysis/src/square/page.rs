//! The page of the experiment, and the same as text for a terminal.

use posebridge_estimator::FilterConfig;
use posebridge_estimator::filters::paper1::DEGREE;

use super::figures::Example;
use super::matched::{SpeedMatrices, WheelMatrices};
use super::noise::{Record, Spread};
use super::score::{Errors, Metric, Order, OrderStep};
use crate::report::NO_VALUE;
use crate::report::page::{Page, Part};

/// Methods in the order that the paper promises, over all drives.
#[derive(Clone, Debug, PartialEq)]
pub struct Chain {
    /// Whose matrices.
    pub setting: &'static str,
    /// From the worst to the best.
    pub names: Vec<&'static str>,
    /// Of each drive, the errors of each.
    pub runs: Vec<Vec<Errors>>,
}

/// Another way to read the paper, and whether its order holds then.
#[derive(Clone, Debug, PartialEq)]
pub struct Reading {
    /// In a word.
    pub name: &'static str,
    /// What is different, and why one could read the paper so.
    pub note: &'static str,
    /// What is compared.
    pub metric: Metric,
    /// Whether it holds.
    pub order: Order,
}

/// All that the experiment found.
#[derive(Clone, Debug)]
pub struct Report {
    /// Where the drives come from, for people.
    pub source: String,
    /// The command that gives this page.
    pub command: String,
    /// The paper's chain under each setting.
    pub chains: Vec<Chain>,
    /// What the paper leaves for later.
    pub outlook: Chain,
    /// Other readings of the paper; none for a file.
    pub readings: Vec<Reading>,
    /// R from the stop at the beginning.
    pub stop: Option<Record>,
    /// R from the longest straight run.
    pub straight: Option<Record>,
    /// The drive of the pictures.
    pub example: Example,
}

/// A line of the table of R.
struct NoiseRow {
    name: &'static str,
    /// The paper's number.
    printed: Option<f64>,
    /// What follows from the resolution of the counts alone.
    rounding: Option<fn(&FilterConfig) -> f64>,
    pick: fn(&Record) -> Option<Spread>,
}

const fn noise_row(name: &'static str, printed: Option<f64>, pick: fn(&Record) -> Option<Spread>) -> NoiseRow {
    NoiseRow { name, printed, rounding: None, pick }
}

impl NoiseRow {
    const fn rounded(mut self, rounding: fn(&FilterConfig) -> f64) -> Self {
        self.rounding = Some(rounding);
        self
    }
}

/// A square metre, in square centimetres.
const CM2_PER_M2: f64 = 1e4;
/// A square radian, in square degrees.
const DEG2_PER_RAD2: f64 = 1.0 / (DEGREE * DEGREE);

/// The paper's R, equations 19, 23 and 26, and the sensors behind them.
const NOISE_ROWS: [NoiseRow; 9] = [
    noise_row("left counter [deg^2]", Some(1.5), |record| Some(record.counters?[0]))
        .rounded(|config| WheelMatrices::of_robot(config).variances[0]),
    noise_row("right counter [deg^2]", Some(2.5), |record| Some(record.counters?[1]))
        .rounded(|config| WheelMatrices::of_robot(config).variances[1]),
    noise_row("v by counters [(cm/s)^2]", Some(5.1), |record| record.forward)
        .rounded(|config| SpeedMatrices::of_robot(config).variances[0] * CM2_PER_M2),
    noise_row("w by counters [(deg/s)^2]", Some(1.938), |record| record.turn)
        .rounded(|config| SpeedMatrices::of_robot(config).variances[1] * DEG2_PER_RAD2),
    noise_row("th_enc [deg^2]", Some(0.938), |record| record.wheel_heading),
    noise_row("th_gyro [deg^2]", Some(0.332), |record| record.gyro_heading),
    noise_row("gyro [(deg/s)^2]", None, |record| record.gyro),
    noise_row("accelerometer left [(m/s^2)^2]", None, |record| Some(record.accelerometers?[0])),
    noise_row("camera x [cm^2]", None, |record| Some(record.camera?[0])),
];

impl Chain {
    /// Whether the order holds.
    #[must_use]
    pub fn order(&self, metric: Metric) -> Order {
        super::score::order(&self.names, &self.runs, metric)
    }

    /// Root mean square of one method's error over the drives that have it; `None` where none has it.
    #[must_use]
    pub fn rms(&self, method: usize, metric: Metric) -> Option<f64> {
        let squares: Vec<f64> =
            self.runs.iter().filter_map(|run| run.get(method)?.of(metric)).map(|error| error * error).collect();
        let count = squares.len() as f64;
        (count > 0.0).then(|| (squares.iter().sum::<f64>() / count).sqrt())
    }

    /// In how many drives one method diverged; [`Chain::rms`] leaves these out.
    #[must_use]
    pub fn diverged(&self, method: usize) -> usize {
        let errors = self.runs.iter().filter_map(|run| run.get(method));
        errors.filter(|errors| errors.diverged).count()
    }
}

impl Report {
    /// The page.
    #[must_use]
    pub fn page(&self) -> Page {
        let mut parts = vec![Part::Text(self.source.clone()), Part::Lines(self.command.clone())];
        parts.extend(self.tables());
        parts.push(Part::Heading("Pictures of one drive".to_owned()));
        parts.extend(self.pictures());
        Page { title: "The square: encoders, wheel filter, speed filter, EKF".to_owned(), parts }
    }

    /// The tables as text for a terminal.
    #[must_use]
    pub fn text(&self) -> String {
        let mut text = self.source.clone() + "\n";
        for part in self.tables() {
            text += &as_text(&part);
        }
        text
    }

    fn tables(&self) -> Vec<Part> {
        let mut parts = vec![Part::Heading("How far off".to_owned()), self.error_table()];
        parts.extend(self.divergences());
        for chain in &self.chains {
            parts.extend(order_parts(chain));
        }
        parts.extend(self.reading_parts());
        parts.extend(self.noise_parts());
        parts
    }

    fn error_table(&self) -> Part {
        let mut rows: Vec<Vec<String>> = Vec::new();
        for chain in self.chains.iter().chain([&self.outlook]) {
            for (method, name) in chain.names.iter().enumerate() {
                if rows.iter().any(|row| row.first().is_some_and(|known| known == name)) {
                    continue;
                }
                let cell = |metric, factor: f64, digits: usize| {
                    let value = chain.rms(method, metric).map(|value| value * factor);
                    value.map_or(NO_VALUE.to_owned(), |value| format!("{value:.digits$}"))
                };
                rows.push(vec![
                    (*name).to_owned(),
                    cell(Metric::Position, 1e3, 1),
                    cell(Metric::End, 1e3, 1),
                    cell(Metric::Heading, 1f64.to_degrees(), 2),
                    cell(Metric::Forward, 1e3, 2),
                    cell(Metric::Turn, 1f64.to_degrees(), 2),
                ]);
            }
        }
        Part::table(
            &["method", "position rms [mm]", "at the end [mm]", "heading rms [deg]", "v rms [mm/s]", "w rms [deg/s]"],
            rows,
        )
    }

    /// Who diverged, and how often; nothing if nobody did.
    fn divergences(&self) -> Option<Part> {
        let mut told: Vec<(&str, String)> = Vec::new();
        for chain in self.chains.iter().chain([&self.outlook]) {
            for (method, name) in chain.names.iter().enumerate() {
                let count = chain.diverged(method);
                if count > 0 && told.iter().all(|(known, _)| known != name) {
                    let drives = chain.runs.len();
                    let line = format!("{name} diverged in {count} of {drives} drives, which its figures leave out");
                    told.push((name, line));
                }
            }
        }
        let lines: Vec<String> = told.into_iter().map(|(_, line)| line).collect();
        (!lines.is_empty()).then_some(Part::List(lines))
    }

    fn reading_parts(&self) -> Vec<Part> {
        if self.readings.is_empty() {
            return Vec::new();
        }
        let rows = self.readings.iter().map(|reading| {
            let mut row = vec![reading.name.to_owned(), reading.metric.name().to_owned()];
            let shares = reading.order.steps.iter().map(OrderStep::share);
            row.extend(shares.map(percent));
            row.push(percent(share(reading.order.all_hold, reading.order.drives)));
            let is_so = reading.order.holds_on_average();
            row.push(if is_so { "yes" } else { "no" }.to_owned());
            row
        });
        let notes = self.readings.iter().map(|reading| {
            let left_out = left_out(&reading.order).map(|text| format!("; {text}"));
            let (name, note) = (reading.name, reading.note);
            format!("{name}: {note}{}", left_out.unwrap_or_default())
        });
        vec![
            Part::Heading("Other readings of the paper, with its matrices".to_owned()),
            Part::Text(
                "Share of the drives in which each step of the order holds. Only a share of 95 % or more is the order of figure 7. The last \
                 column asks for less: whether the error falls with each step on average, at 95 %."
                    .to_owned(),
            ),
            Part::table(
                &[
                    "reading",
                    "compared by",
                    "raw > wheel-kf",
                    "wheel-kf > velocity-kf",
                    "velocity-kf > ekf5",
                    "all three",
                    "on average",
                ],
                rows.collect(),
            ),
            Part::List(notes.collect()),
        ]
    }

    fn noise_parts(&self) -> Vec<Part> {
        let length = |record: Option<&Record>| record.map_or(0, |record| record.rows);
        vec![
            Part::Heading("R from a stop and from a straight run".to_owned()),
            Part::Text(format!(
                "The stop has {} rows, the straight run {}. At rest a counter stands still, so its R comes out as zero: only the straight run \
                 shows the rounding, a twelfth of a tick squared. Gyro and accelerometers are taken from the stop: on the straight run the robot \
                 steers, and camera x is the motion itself.",
                length(self.stop.as_ref()),
                length(self.straight.as_ref())
            )),
            Part::table(
                &["R of", "paper", "rounding", "stop", "straight run"],
                NOISE_ROWS.iter().map(|row| self.noise_row(row)).collect(),
            ),
        ]
    }

    fn noise_row(&self, row: &NoiseRow) -> Vec<String> {
        let number =
            |value: Option<f64>, digits: usize| value.map_or(NO_VALUE.to_owned(), |value| format!("{value:.digits$}"));
        let variance = |record: &Option<Record>| {
            let spread = record.as_ref().and_then(row.pick);
            number(spread.map(|spread| spread.variance), 4)
        };
        let config = &self.example.config;
        let rounding = row.rounding.map(|rounding| rounding(config));
        vec![
            row.name.to_owned(),
            number(row.printed, 3),
            number(rounding, 4),
            variance(&self.stop),
            variance(&self.straight),
        ]
    }

    fn pictures(&self) -> Vec<Part> {
        let example = &self.example;
        let chain: Vec<&str> = self.chains.first().map_or(Vec::new(), |chain| chain.names.clone());
        let own: Vec<&str> = self.chains.get(1).map_or(Vec::new(), |chain| chain.names.clone());
        let figure = |svg, caption: &str| Part::Figure { svg, caption: caption.to_owned() };
        vec![
            figure(
                example.wheel_figure(),
                "Figure 5: positions lie on each other; the printed filter smooths the speeds and lags where they change.",
            ),
            figure(
                example.speed_figure(&chain),
                "Figure 6: v and w of the printed filters against the differences of the counts.",
            ),
            figure(
                example.track_figure("Tracks, the paper's matrices", &chain),
                "Figure 7: raw encoders and wheel-kf lie on each other, velocity-kf adds what its accelerometers add, ekf5 leans on the gyro.",
            ),
            figure(
                example.track_figure("Tracks, matrices that follow from the sensors", &own),
                "Figure 7 with the corrected chain.",
            ),
            figure(
                example.track_figure("Tracks, the outlook", &self.outlook.names),
                "What the paper leaves for later: sigma points, compass, camera, all sensors in one filter.",
            ),
        ]
    }
}

fn order_parts(chain: &Chain) -> Vec<Part> {
    let order = chain.order(Metric::Position);
    let mut rows: Vec<Vec<String>> = order.steps.iter().map(order_row).collect();
    rows.push(vec!["all of them together".to_owned(), percent(share(order.all_hold, order.drives))]);
    let mut parts = vec![
        Part::Heading(format!("The order, {}", chain.setting)),
        Part::table(
            &["worse than, by position rms", "share of drives", "sign test p", "ratio", "95 % interval", "verdict"],
            rows,
        ),
    ];
    parts.extend(left_out(&order).map(Part::Text));
    parts
}

/// How many drives an order leaves out; nothing if it leaves out none.
fn left_out(order: &Order) -> Option<String> {
    (order.left_out > 0).then(|| {
        format!(
            "{} of {} drives are left out: a method diverged, or there was nothing to compare with",
            order.left_out,
            order.left_out + order.drives
        )
    })
}

fn order_row(step: &OrderStep) -> Vec<String> {
    let [ratio, interval] = step.ratio.map_or([NO_VALUE.to_owned(), NO_VALUE.to_owned()], |ratio| {
        let [mean, low, high] = ratio;
        [format!("{mean:.3}"), format!("{low:.3} to {high:.3}")]
    });
    vec![
        format!("{} > {}", step.worse, step.better),
        percent(step.share()),
        format!("{:.1e}", step.sign_p),
        ratio,
        interval,
        step.in_words().to_owned(),
    ]
}

fn share(holds: u64, drives: u64) -> f64 {
    holds as f64 / drives.max(1) as f64
}

fn percent(share: f64) -> String {
    format!("{:.0} %", 100.0 * share)
}

/// A part for a terminal; pictures have none.
fn as_text(part: &Part) -> String {
    match part {
        Part::Heading(text) | Part::Subheading(text) => format!("\n{text}\n"),
        Part::Text(text) | Part::Lines(text) => format!("{text}\n"),
        Part::Verdict { word, text, .. } => format!("{word}: {text}\n"),
        Part::List(points) => format!("- {}\n", points.join("\n- ")),
        Part::Table { header, rows } | Part::Listing { header, rows } => aligned(header, rows),
        Part::Figure { .. } | Part::Pictures(_) => String::new(),
    }
}

/// Columns that line up: the first to the left, all others to the right.
fn aligned(header: &[String], rows: &[Vec<String>]) -> String {
    let lines = || [header].into_iter().chain(rows.iter().map(Vec::as_slice));
    let widths: Vec<usize> = (0..header.len())
        .map(|column| {
            let cells = lines().filter_map(|line| line.get(column));
            cells.map(|cell| cell.chars().count()).max().unwrap_or(0)
        })
        .collect();
    let mut text = String::new();
    for line in lines() {
        let cells = line.iter().zip(&widths).enumerate();
        let cells = cells.map(
            |(column, (cell, width))| {
                if column == 0 { format!("{cell:<width$}") } else { format!("  {cell:>width$}") }
            },
        );
        text += cells.collect::<String>().trim_end();
        text.push('\n');
    }
    text
}
