//! Sections on dynamics that are identified first: orders, other data, heating and cooling.

use posebridge_estimator::models::dynamic_measurement::DynamicModel;
use posebridge_estimator::models::slow_sensor::{SensorDynamics, SlowLag};
use posebridge_report::chart::{Curve, CurveShape, Plot};
use posebridge_telemetry::SensorId;

use super::paper_filter::DynamicFilterConfig;
use super::section::{LessonSection, band, filter_values, sample_points, seconds, settling_times_s, temperatures};
use crate::identification::prediction::{EndPrediction, predict};
use crate::identification::sensor_kind::{RunSimilarity, describe_sensor};
use crate::identification::step::{IdentificationError, IdentifiedStep, StepOptions, identify_step};
use crate::identification::step_response::{SimulatedSensor, step_input};
use crate::identification::{TimedSample, settling_time_s};

const SIGMA_K: f64 = 0.05;
const PERIOD_S: f64 = 0.5;
pub(super) const DIPPED_S: f64 = 20.0;
/// A probe in a sleeve: a third of the step is fast.
pub(super) const LAGS: [(f64, f64); 2] = [(3.0, 0.35), (15.0, 0.65)];

fn sensor(lags: &[(f64, f64)]) -> SimulatedSensor {
    SimulatedSensor { lags: lags.to_vec(), sigma: SIGMA_K, resolution: 0.0, period_s: PERIOD_S }
}

/// Temperatures before and after a probe is dipped, in degrees Celsius.
#[derive(Clone, Copy)]
pub(super) struct DipTemperatures {
    pub(super) before: f64,
    pub(super) after: f64,
}

pub(super) fn simulate_dip(lags: &[(f64, f64)], seed: u64, dip: DipTemperatures) -> Vec<TimedSample> {
    let count = (8.0 * slowest(lags) / PERIOD_S) as usize + 40;
    sensor(lags).run(seed, count, step_input(dip.before, dip.after, DIPPED_S))
}

fn slowest(lags: &[(f64, f64)]) -> f64 {
    lags.iter().map(|(tau_s, _)| *tau_s).fold(0.0, f64::max)
}

fn identify(samples: &[TimedSample]) -> Result<IdentifiedStep, IdentificationError> {
    identify_step(samples, &StepOptions::with_sigma(SIGMA_K))
}

/// The section for data that cannot be identified; does not happen with the seeds of the tests.
fn failed_section(mut section: LessonSection, why: impl std::fmt::Display) -> LessonSection {
    section.paragraphs.push(format!("This run could not be identified: {why}."));
    section
}

pub(super) fn orders(seed: u64) -> LessonSection {
    let samples = simulate_dip(&LAGS, seed, DipTemperatures { before: 20.0, after: 4.0 });
    let mut section = LessonSection::new(
        "orders",
        "Identification from a step, and its order",
        format!(
            "A simulated probe with lags of {} s ({} of the step) and {} s is dipped from 20 into 4 degrees, noise {SIGMA_K} K. One, two and three exponentials are fitted; the \
             least criterion of those whose shares all differ from zero is chosen.",
            LAGS[0].0, LAGS[0].1, LAGS[1].0
        ),
        &["order", "left over, rms [K]", "criterion", "lags [s]", "shares"],
    );
    let found = match identify(&samples) {
        Ok(found) => found,
        Err(error) => return failed_section(section, error),
    };
    for candidate in &found.candidates {
        let fit = &candidate.fit;
        let lags = fit.response.lags.iter().enumerate();
        let (lags, shares): (Vec<String>, Vec<String>) = lags
            .map(|(j, lag)| {
                let sigma_s = lag.time_constant_s * fit.ln_lag_sigma(j);
                let lag_cell = format!("{:.2} +- {sigma_s:.2}", lag.time_constant_s);
                (lag_cell, format!("{:.3} +- {:.3}", lag.share, fit.share_sigma(j)))
            })
            .unzip();
        section.rows.push(vec![
            fit.response.lags.len().to_string(),
            format!("{:.4}", candidate.residual_rms),
            format!("{:.0}", candidate.criterion),
            lags.join(", "),
            shares.join(", "),
        ]);
    }
    section.record_value("order", found.order() as f64);
    for (j, (lag, truth)) in found.lags().iter().zip(LAGS).enumerate() {
        section.record_value(format!("lag_{}_s", j + 1), lag.time_constant_s);
        section.record_value(format!("lag_{}_sigma_s", j + 1), lag.time_constant_sigma_s);
        let sigmas = (lag.time_constant_s - truth.0) / lag.time_constant_sigma_s;
        section.record_value(format!("lag_{}_error_sigmas", j + 1), sigmas);
    }
    section.figure =
        Some((fit_plot(&found), "Above: the samples and the fits. Below: what each order leaves.".to_owned()));
    section
}

fn fit_plot(found: &IdentifiedStep) -> Plot {
    let mut above = vec![Curve::line("shown", sample_points(&found.samples))];
    let mut below = vec![];
    for candidate in &found.candidates {
        let response = &candidate.fit.response;
        let name = format!("order {}", response.lags.len());
        let fitted = found.samples.iter().map(|sample| (sample.at_s, response.value_at(sample.at_s)));
        let left = found.samples.iter().map(|sample| (sample.at_s, sample.value - response.value_at(sample.at_s)));
        below.push(Curve::line(name.as_str(), left));
        above.push(Curve::line(name.as_str(), fitted));
    }
    // The first panel's first curve has no partner below; a level keeps the colours of the orders alike.
    below.insert(0, Curve::new("nothing left", CurveShape::Level(0.0)));
    temperatures("A step response and its exponentials", vec![above, below])
}

fn settling_bounds(predictions: &[EndPrediction]) -> Vec<(f64, f64, f64)> {
    let moving = predictions.iter().filter(|prediction| prediction.is_settling);
    moving.map(|p| (p.at_s, p.value, p.sigma)).collect()
}

pub(super) fn other_data(seed: u64) -> LessonSection {
    let taught = DipTemperatures { before: 22.0, after: 8.0 };
    let next = DipTemperatures { before: 20.0, after: 4.0 };
    let first = simulate_dip(&LAGS, seed, taught);
    // Another day: less stirring, every lag is a fifth slower.
    let slower = LAGS.map(|(tau_s, share)| (1.2 * tau_s, share));
    let other = simulate_dip(&slower, seed.wrapping_add(1), next);
    let same = simulate_dip(&LAGS, seed.wrapping_add(2), next);
    let mut section = LessonSection::new(
        "other_data",
        "Prediction on the same and on other data",
        "The model is identified on one run and used on that run itself (data), on another one with the same dynamics (same), and on one in water that is stirred less, where every \
             lag is a fifth longer (other). The paper's filter takes the lags for certain and is read from the dip on. The other filter knows them with an uncertainty, and finds the dip by itself. The \
             table has the seconds until within 10, 5 and 2 % of the step for good.",
        &["run", "method", "10 %", "5 %", "2 %"],
    );
    let models = match IdentifiedModels::of(&first) {
        Ok(models) => models,
        Err(why) => return failed_section(section, why),
    };
    let mut panels = vec![];
    for (name, samples, dip) in [("data", &first, taught), ("same", &same, next), ("other", &other, next)] {
        let followed = models.run_filters(samples);
        followed.add_rows(&mut section, name, samples, dip);
        panels.push(followed.curves(samples, dip.after));
    }
    // The run that taught the model looks like its neighbour.
    panels.remove(0);
    let picture = temperatures("Another run, and another run in other water", panels);
    section.figure = Some((picture, "Above: the same dynamics. Below: every lag a fifth longer.".to_owned()));
    section
}

/// Models identified from one run for predicting the next: with exact lags and with uncertain ones.
pub(super) struct IdentifiedModels {
    certain: DynamicModel,
    description: SensorDynamics,
}

impl IdentifiedModels {
    pub(super) fn of(samples: &[TimedSample]) -> Result<Self, String> {
        let found = identify(samples).map_err(|error| error.to_string())?;
        let lags_s: Vec<f64> = found.lags().iter().map(|lag| lag.time_constant_s).collect();
        let certain = DynamicModel::empty().with_lags(SensorId::THERMOMETER, 1.0, &lags_s);
        let description = describe_sensor(&[found], RunSimilarity::SameKind).ok_or("no lag was found")?;
        Ok(Self { certain: certain.map_err(|error| error.to_string())?, description })
    }

    /// Of the paper's filter, with exact lags and from the dip on, and of the one with uncertain lags.
    pub(super) fn predictions(&self, samples: &[TimedSample]) -> [Vec<EndPrediction>; 2] {
        let dipped: Vec<TimedSample> = samples.iter().filter(|sample| sample.at_s >= DIPPED_S).copied().collect();
        let certain = DynamicFilterConfig::constant(SIGMA_K).run_sensor(&self.certain, &dipped);
        let certain =
            certain.into_iter().map(|(at_s, value, sigma)| EndPrediction { at_s, value, sigma, is_settling: true });
        [certain.collect(), predict(samples, SIGMA_K, &self.description)]
    }

    fn run_filters(&self, samples: &[TimedSample]) -> FilterPredictions {
        let [certain, estimated] = self.predictions(samples);
        FilterPredictions { certain: settling_bounds(&certain), estimated: settling_bounds(&estimated) }
    }
}

struct FilterPredictions {
    certain: Vec<(f64, f64, f64)>,
    estimated: Vec<(f64, f64, f64)>,
}

impl FilterPredictions {
    fn add_rows(&self, section: &mut LessonSection, name: &str, samples: &[TimedSample], dip: DipTemperatures) {
        for (method, series) in [
            ("shown", sample_points(samples)),
            ("certain", filter_values(&self.certain)),
            ("estimated", filter_values(&self.estimated)),
        ] {
            let settled = settling_times_s(&series, DIPPED_S, dip.after, (dip.after - dip.before).abs());
            let cells = settled.map(seconds).to_vec();
            let names = vec![name.to_owned(), method.to_owned()];
            section.rows.push([names, cells].concat());
            for (share, settled) in ["10", "5", "2"].into_iter().zip(settled) {
                section.record_value(format!("{name}_{method}_{share}_percent_s"), settled);
            }
        }
    }

    fn curves(&self, samples: &[TimedSample], end: f64) -> Vec<Curve> {
        // The first seconds say nothing, with a band as wide as the picture.
        let later = |all: &[(f64, f64, f64)]| -> Vec<(f64, f64, f64)> {
            let resolved = all.iter().filter(|(_, _, sigma)| *sigma < 2.0);
            resolved.copied().collect()
        };
        let estimated = later(&self.estimated);
        vec![
            Curve::new("truth", CurveShape::Level(end)),
            Curve::line("certain", filter_values(&later(&self.certain))),
            Curve::line("estimated", filter_values(&estimated)),
            Curve::line("shown", sample_points(samples)),
            band("estimated, 95 %", &estimated),
        ]
    }
}

pub(super) fn both_directions(seed: u64) -> LessonSection {
    let (warm, cold) = (50.0, 20.0);
    let (up, down) = ([(2.0, 1.0)], [(2.6, 1.0)]);
    let rising = simulate_dip(&up, seed, DipTemperatures { before: cold, after: warm });
    let cooling = DipTemperatures { before: warm, after: cold };
    let falling = simulate_dip(&down, seed.wrapping_add(1), cooling);
    let mut section = LessonSection::new(
        "both_ways",
        "Heating and cooling apart",
        "Heat goes into a probe through another film of water than out of it. A simulated probe has 2.0 s on the way up and 2.6 s on the way down. A description by heating alone \
             expects the wrong lag, one by cooling the right one, and one by both is between them.",
        &["identified by", "expected [s]", "sigma of ln", "cooling known to 5 % after [s]"],
    );
    let (up, down) = match (identify(&rising), identify(&falling)) {
        (Ok(up), Ok(down)) => (up, down),
        (Err(error), _) | (_, Err(error)) => return failed_section(section, error),
    };
    let next = simulate_dip(&[(2.6, 1.0)], seed.wrapping_add(2), cooling);
    let teachers = [("heating", vec![up.clone()]), ("cooling", vec![down.clone()]), ("both", vec![up, down])];
    for (name, runs) in teachers {
        let description = describe_sensor(&runs, RunSimilarity::SameSensor);
        let Some((description, SlowLag::Known(lag))) = description.map(|known| (known, known.slow_lag)) else {
            return failed_section(section, "no lag was found");
        };
        let predictions = settling_bounds(&predict(&next, SIGMA_K, &description));
        let settled = settling_time_s(&filter_values(&predictions), DIPPED_S, cold, 0.05 * (warm - cold));
        section.rows.push(vec![
            name.to_owned(),
            format!("{:.2}", lag.median),
            format!("{:.3}", lag.ln_sigma),
            seconds(settled),
        ]);
        section.record_value(format!("by_{name}_expected_s"), lag.median);
        section.record_value(format!("by_{name}_5_percent_s"), settled);
    }
    section
}
