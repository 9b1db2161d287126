//! The page of the experiment, and the same as text for a terminal.

use posebridge_estimator::FilterConfig;
use posebridge_estimator::papers::paper1::DEGREE;
use posebridge_report::page::{ReportBlock, ReportPage};
use posebridge_report::tables::{NO_VALUE, TextTable};

use super::figures::SquareExample;
use super::matched::{SpeedMatrices, WheelMatrices};
use super::noise::{MeanAndVariance, NoiseRecord};
use super::score::{ErrorMetric, MethodOrder, OrderStep, PathErrors};

/// Methods in the order that the paper promises, over all drives.
#[derive(Clone, Debug, PartialEq)]
pub struct MethodRanking {
    /// Whose matrices.
    pub matrices: &'static str,
    /// From the worst to the best.
    pub names: Vec<&'static str>,
    /// Of each drive, the errors of each.
    pub runs: Vec<Vec<PathErrors>>,
}

/// Another way to read the paper, and whether its order holds then.
#[derive(Clone, Debug, PartialEq)]
pub struct PaperInterpretation {
    /// In a word.
    pub name: &'static str,
    /// What is different, and why one could read the paper so.
    pub note: &'static str,
    /// What is compared.
    pub metric: ErrorMetric,
    /// Whether it holds.
    pub order: MethodOrder,
}

/// All that the experiment found.
#[derive(Clone, Debug)]
pub struct SquareReport {
    /// Where the drives come from, for people.
    pub source: String,
    /// The command that gives this page.
    pub command: String,
    /// The paper's chain under each setting.
    pub rankings: Vec<MethodRanking>,
    /// What the paper leaves for later.
    pub extended: MethodRanking,
    /// Other readings of the paper; none for a file.
    pub interpretations: Vec<PaperInterpretation>,
    /// R from the stop at the beginning.
    pub stop: Option<NoiseRecord>,
    /// R from the longest straight run.
    pub straight: Option<NoiseRecord>,
    /// The drive of the pictures.
    pub example: SquareExample,
}

/// A line of the table of R.
struct NoiseRow {
    name: &'static str,
    /// The paper's number.
    printed: Option<f64>,
    /// What follows from the resolution of the counts alone.
    rounding: Option<fn(&FilterConfig) -> f64>,
    pick: fn(&NoiseRecord) -> Option<MeanAndVariance>,
}

/// A square metre, in square centimetres.
const CM2_PER_M2: f64 = 1e4;
/// A square radian, in square degrees.
const DEG2_PER_RAD2: f64 = 1.0 / (DEGREE * DEGREE);

/// The paper's R, equations 19, 23 and 26, and the sensors behind them.
const NOISE_ROWS: [NoiseRow; 9] = [
    NoiseRow {
        name: "left counter [deg^2]",
        printed: Some(1.5),
        rounding: Some(|config| WheelMatrices::of_robot(config).variances[0]),
        pick: |record| Some(record.counters?[0]),
    },
    NoiseRow {
        name: "right counter [deg^2]",
        printed: Some(2.5),
        rounding: Some(|config| WheelMatrices::of_robot(config).variances[1]),
        pick: |record| Some(record.counters?[1]),
    },
    NoiseRow {
        name: "v by counters [(cm/s)^2]",
        printed: Some(5.1),
        rounding: Some(|config| SpeedMatrices::of_robot(config).variances[0] * CM2_PER_M2),
        pick: |record| record.forward,
    },
    NoiseRow {
        name: "w by counters [(deg/s)^2]",
        printed: Some(1.938),
        rounding: Some(|config| SpeedMatrices::of_robot(config).variances[1] * DEG2_PER_RAD2),
        pick: |record| record.turn,
    },
    NoiseRow { name: "th_enc [deg^2]", printed: Some(0.938), rounding: None, pick: |record| record.wheel_heading },
    NoiseRow { name: "th_gyro [deg^2]", printed: Some(0.332), rounding: None, pick: |record| record.gyro_heading },
    NoiseRow { name: "gyro [(deg/s)^2]", printed: None, rounding: None, pick: |record| record.gyro },
    NoiseRow {
        name: "accelerometer left [(m/s^2)^2]",
        printed: None,
        rounding: None,
        pick: |record| Some(record.accelerometers?[0]),
    },
    NoiseRow { name: "camera x [cm^2]", printed: None, rounding: None, pick: |record| Some(record.camera?[0]) },
];

impl MethodRanking {
    /// Whether the order holds.
    #[must_use]
    pub fn order(&self, metric: ErrorMetric) -> MethodOrder {
        super::score::compare_order(&self.names, &self.runs, metric)
    }

    /// Root mean square of one method's error over the drives that have it; `None` where none has it.
    #[must_use]
    pub fn rms(&self, method: usize, metric: ErrorMetric) -> Option<f64> {
        let squares: Vec<f64> =
            self.runs.iter().filter_map(|run| run.get(method)?.value(metric)).map(|error| error * error).collect();
        let count = squares.len() as f64;
        (count > 0.0).then(|| (squares.iter().sum::<f64>() / count).sqrt())
    }

    /// In how many drives one method diverged; [`MethodRanking::rms`] leaves these out.
    #[must_use]
    pub fn diverged(&self, method: usize) -> usize {
        let errors = self.runs.iter().filter_map(|run| run.get(method));
        errors.filter(|errors| errors.diverged).count()
    }
}

impl SquareReport {
    /// The page.
    #[must_use]
    pub fn page(&self) -> ReportPage {
        let mut parts =
            vec![ReportBlock::Text(self.source.clone()), ReportBlock::PreformattedText(self.command.clone())];
        parts.extend(self.tables());
        parts.push(ReportBlock::Heading("Pictures of one drive".to_owned()));
        parts.extend(self.pictures());
        ReportPage { title: "The square: encoders, wheel filter, speed filter, EKF".to_owned(), blocks: parts }
    }

    /// The tables as text for a terminal.
    #[must_use]
    pub fn text(&self) -> String {
        let mut text = self.source.clone() + "\n";
        for part in self.tables() {
            text += &block_text(&part);
        }
        text
    }

    fn tables(&self) -> Vec<ReportBlock> {
        let mut parts = vec![ReportBlock::Heading("How far off".to_owned()), self.error_table()];
        parts.extend(self.divergences());
        for chain in &self.rankings {
            parts.extend(order_parts(chain));
        }
        parts.extend(self.reading_parts());
        parts.extend(self.noise_parts());
        parts
    }

    fn error_table(&self) -> ReportBlock {
        let mut rows: Vec<Vec<String>> = Vec::new();
        for chain in self.rankings.iter().chain([&self.extended]) {
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
                    cell(ErrorMetric::Position, 1e3, 1),
                    cell(ErrorMetric::End, 1e3, 1),
                    cell(ErrorMetric::Heading, 1f64.to_degrees(), 2),
                    cell(ErrorMetric::Forward, 1e3, 2),
                    cell(ErrorMetric::Turn, 1f64.to_degrees(), 2),
                ]);
            }
        }
        ReportBlock::table(
            &["method", "position rms [mm]", "at the end [mm]", "heading rms [deg]", "v rms [mm/s]", "w rms [deg/s]"],
            rows,
        )
    }

    /// Who diverged, and how often; empty if none did.
    fn divergences(&self) -> Option<ReportBlock> {
        let mut told: Vec<(&str, String)> = Vec::new();
        for chain in self.rankings.iter().chain([&self.extended]) {
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
        (!lines.is_empty()).then_some(ReportBlock::List(lines))
    }

    fn reading_parts(&self) -> Vec<ReportBlock> {
        if self.interpretations.is_empty() {
            return Vec::new();
        }
        let rows = self.interpretations.iter().map(|reading| {
            let mut row = vec![reading.name.to_owned(), reading.metric.name().to_owned()];
            let shares = reading.order.steps.iter().map(OrderStep::share);
            row.extend(shares.map(percent));
            row.push(percent(share(reading.order.all_hold, reading.order.drives)));
            let is_so = reading.order.holds_on_average();
            row.push(if is_so { "yes" } else { "no" }.to_owned());
            row
        });
        let notes = self.interpretations.iter().map(|reading| {
            let left_out = excluded_text(&reading.order).map(|text| format!("; {text}"));
            let (name, note) = (reading.name, reading.note);
            format!("{name}: {note}{}", left_out.unwrap_or_default())
        });
        vec![
            ReportBlock::Heading("Other readings of the paper, with its matrices".to_owned()),
            ReportBlock::Text(
                "Share of the drives in which each step of the order holds. Only a share of 95 % or more is the order of figure 7. The last \
                 column asks for less: whether the error falls with each step on average, at 95 %."
                    .to_owned(),
            ),
            ReportBlock::table(
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
            ReportBlock::List(notes.collect()),
        ]
    }

    fn noise_parts(&self) -> Vec<ReportBlock> {
        let length = |record: Option<&NoiseRecord>| record.map_or(0, |record| record.rows);
        vec![
            ReportBlock::Heading("R from a stop and from a straight run".to_owned()),
            ReportBlock::Text(format!(
                "The stop has {} rows, the straight run {}. At rest a counter stands still, so its R comes out as zero: only the straight run \
                 shows the rounding, a twelfth of a tick squared. Gyro and accelerometers are taken from the stop: on the straight run the robot \
                 steers, and camera x is the motion itself.",
                length(self.stop.as_ref()),
                length(self.straight.as_ref())
            )),
            ReportBlock::table(
                &["R of", "paper", "rounding", "stop", "straight run"],
                NOISE_ROWS.iter().map(|row| self.noise_row(row)).collect(),
            ),
        ]
    }

    fn noise_row(&self, row: &NoiseRow) -> Vec<String> {
        let number =
            |value: Option<f64>, digits: usize| value.map_or(NO_VALUE.to_owned(), |value| format!("{value:.digits$}"));
        let variance = |record: &Option<NoiseRecord>| {
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

    fn pictures(&self) -> Vec<ReportBlock> {
        let example = &self.example;
        let chain: Vec<&str> = self.rankings.first().map_or(Vec::new(), |chain| chain.names.clone());
        let own: Vec<&str> = self.rankings.get(1).map_or(Vec::new(), |chain| chain.names.clone());
        let figure = |svg, caption: &str| ReportBlock::Figure { svg, caption: caption.to_owned() };
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
                example.track_figure("Tracks, the outlook", &self.extended.names),
                "What the paper leaves for later: sigma points, compass, camera, all sensors in one filter.",
            ),
        ]
    }
}

fn order_parts(chain: &MethodRanking) -> Vec<ReportBlock> {
    let order = chain.order(ErrorMetric::Position);
    let mut rows: Vec<Vec<String>> = order.steps.iter().map(order_row).collect();
    rows.push(vec!["all of them together".to_owned(), percent(share(order.all_hold, order.drives))]);
    let mut parts = vec![
        ReportBlock::Heading(format!("The order, {}", chain.matrices)),
        ReportBlock::table(
            &["worse than, by position rms", "share of drives", "sign test p", "ratio", "95 % interval", "verdict"],
            rows,
        ),
    ];
    parts.extend(excluded_text(&order).map(ReportBlock::Text));
    parts
}

/// How many drives an order leaves out; nothing if it leaves out none.
fn excluded_text(order: &MethodOrder) -> Option<String> {
    (order.excluded > 0).then(|| {
        format!(
            "{} of {} drives are left out: a method diverged, or there was nothing to compare with",
            order.excluded,
            order.excluded + order.drives
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
        step.as_text().to_owned(),
    ]
}

fn share(holds: u64, drives: u64) -> f64 {
    holds as f64 / drives.max(1) as f64
}

fn percent(share: f64) -> String {
    format!("{:.0} %", 100.0 * share)
}

/// A part for a terminal; pictures have none.
fn block_text(part: &ReportBlock) -> String {
    match part {
        ReportBlock::Heading(text) | ReportBlock::Subheading(text) => format!("\n{text}\n"),
        ReportBlock::Text(text) | ReportBlock::PreformattedText(text) => format!("{text}\n"),
        ReportBlock::Verdict { word, text, .. } => format!("{word}: {text}\n"),
        ReportBlock::List(points) => format!("- {}\n", points.join("\n- ")),
        ReportBlock::Table { header, rows } | ReportBlock::CodeTable { header, rows } => {
            let mut table = TextTable::new(header.iter().cloned());
            for row in rows {
                table.push(row.iter().cloned());
            }
            table.render()
        }
        ReportBlock::Figure { .. } | ReportBlock::FigureGrid(_) => String::new(),
    }
}
