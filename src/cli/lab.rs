//! Flags of `lab`: the experiments whose flags are not beside their own code.

use clap::{Args, Subcommand};
use posebridge_sim::montecarlo::SCENARIOS;

use crate::commands::lab::Estimator;
use crate::commands::lab::outcome::OutputArgs;

/// Flags of `lab`.
#[derive(Args, Clone, Debug)]
pub struct LabArgs {
    /// Which experiment.
    #[command(subcommand)]
    pub experiment: LabExperiment,
}

/// The experiments.
#[derive(Clone, Debug, Subcommand)]
pub enum LabExperiment {
    /// Run every estimator over the Monte-Carlo scenarios: errors, and whether the claimed ones are right.
    ///
    /// Prints one table per scenario and writes the page lab-accuracy.html with its picture.
    /// docs/lab-accuracy.md describes --json.
    #[command(after_long_help = accuracy_help())]
    Accuracy(LabAccuracyArgs),
    /// Align clocks and drive laps over links that delay, lose and damage, in virtual time.
    ///
    /// Prints a table of the clocks and one of the poses, and writes the page lab-links.html with its picture.
    /// docs/lab-links.md describes --json.
    Links(LabLinksArgs),
    /// Run the filters of paper 1 on its square, on exported sensor data, on recordings or a live robot: errors, order, R, figures.
    NxtSquare(crate::commands::lab::nxt_square::LabNxtSquareArgs),
    /// Tell what a slow thermometer will show in the end, simulated or recorded, and how it is identified (docs/lab/thermometer.md).
    Thermometer(crate::commands::lab::thermometer::LabThermometerArgs),
    /// Paper 3: identify a car before a wall, and stop it there by readings, lines and filters; or foretell a recorded or a live
    /// robot's readings.
    Wall(crate::commands::lab::wall::LabWallArgs),
    /// Paper 4: a square by wheels alone, and with accelerometers by the indirect filter, fed forward and back; simulated, recorded or
    /// live.
    Indirect(crate::commands::lab::indirect::LabIndirectArgs),
}

/// Flags of `lab links`.
#[derive(Args, Clone, Debug)]
pub struct LabLinksArgs {
    /// A bundled link profile's name or a TOML file; may be repeated. Without it all bundled ones.
    #[arg(long = "profile", value_name = "NAME|FILE.toml")]
    pub profiles: Vec<String>,
    /// Probability that what is sent at once is lost, each way, on top of the profile; several with commas.
    #[arg(long = "loss", value_name = "P,..", value_delimiter = ',', default_values_t = [0.0, 0.05], value_parser = a_probability)]
    pub losses: Vec<f64>,
    /// Delay of each way on top of the profile, ms; several with commas.
    #[arg(long = "delay-ms", value_name = "MS,..", value_delimiter = ',', default_values_t = [0.0, 50.0], value_parser = a_delay_ms)]
    pub delays_ms: Vec<f64>,
    /// Rate error of the brick's clock, ppm; several with commas.
    #[arg(long = "skew-ppm", value_name = "PPM,..", value_delimiter = ',', default_values_t = [50.0, 2021.0], value_parser = a_skew_ppm, allow_hyphen_values = true)]
    pub skews_ppm: Vec<f64>,
    /// Laps of each case; world and link differ from lap to lap.
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub runs: u32,
    /// Seed of the first lap.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// What to leave.
    #[command(flatten)]
    pub output: OutputArgs,
}

fn a_probability(text: &str) -> Result<f64, String> {
    number_within(text, 0.0..=0.99)
}

fn a_delay_ms(text: &str) -> Result<f64, String> {
    number_within(text, 0.0..=10_000.0)
}

/// As far off as the alignment allows.
fn a_skew_ppm(text: &str) -> Result<f64, String> {
    let most_ppm = posebridge_pipeline::clock::LARGEST_SKEW * 1e6;
    number_within(text, -most_ppm..=most_ppm)
}

fn number_within(text: &str, range: std::ops::RangeInclusive<f64>) -> Result<f64, String> {
    let number: f64 = text.parse().map_err(|_no_number| format!("`{text}` is not a number"))?;
    if range.contains(&number) {
        Ok(number)
    } else {
        Err(format!("{number} is not from {} to {}", range.start(), range.end()))
    }
}

/// Flags of `lab accuracy`.
#[derive(Args, Clone, Debug)]
pub struct LabAccuracyArgs {
    /// A bundled scenario's name or a TOML file; may be repeated. Without it all bundled ones.
    #[arg(long = "scenario", value_name = "NAME|FILE.toml")]
    pub scenarios: Vec<String>,
    /// An estimator's name; may be repeated. Without it all that estimate a pose.
    #[arg(long = "estimator", value_name = "NAME")]
    pub estimators: Vec<String>,
    /// Runs of each scenario, instead of what its file says (mostly 40).
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=i64::from(posebridge_sim::montecarlo::MAX_RUNS)))]
    pub runs: Option<u32>,
    /// Base seed, instead of each scenario's.
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// What to leave.
    #[command(flatten)]
    pub output: OutputArgs,
}

/// What `lab accuracy` can run, from the tables.
fn accuracy_help() -> String {
    let scenarios = SCENARIOS.iter().map(|(name, _)| format!("  {name}\n"));
    let estimators =
        Estimator::all().into_iter().map(|estimator| format!("  {:20} {}\n", estimator.name(), estimator.summary()));
    let lines: Vec<String> = std::iter::once("Scenarios:\n".to_owned())
        .chain(scenarios)
        .chain(std::iter::once("Estimators:\n".to_owned()))
        .chain(estimators)
        .collect();
    lines.concat()
}
