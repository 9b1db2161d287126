//! Dynamics that have to be found out first: orders, other data, heating and cooling.

use super::super::kind::{Expectation, Kind, Likeness};
use super::super::prediction::{Prediction, predict, predict_as_expected};
use super::super::simulated::{SimulatedSensor, step};
use super::super::step::{IdentifiedStep, StepError, StepOptions, identify_step};
use super::super::{Sample, settled_after_s};
use super::live::{band, level, line, shown, temperatures, values};
use super::{Section, header, seconds};

const SIGMA_K: f64 = 0.05;
const PERIOD_S: f64 = 0.5;
/// When the thermometer is dipped in, in seconds.
pub(super) const DIPPED_S: f64 = 20.0;
/// A probe in a sleeve: a third of it follows quickly.
pub(super) const LAGS: [(f64, f64); 2] = [(3.0, 0.35), (15.0, 0.65)];

fn sensor(lags: &[(f64, f64)]) -> SimulatedSensor {
    SimulatedSensor { lags: lags.to_vec(), sigma: SIGMA_K, last_digit: 0.0, period_s: PERIOD_S }
}

pub(super) fn dipped(lags: &[(f64, f64)], seed: u64, (before, after): (f64, f64)) -> Vec<Sample> {
    let count = (8.0 * slowest(lags) / PERIOD_S) as usize + 40;
    sensor(lags).run(seed, count, step(before, after, DIPPED_S))
}

fn slowest(lags: &[(f64, f64)]) -> f64 {
    lags.iter().map(|(tau_s, _)| *tau_s).fold(0.0, f64::max)
}

fn identify(samples: &[Sample]) -> Result<IdentifiedStep, StepError> {
    identify_step(samples, &StepOptions::with_sigma(SIGMA_K))
}

/// What stands in a section whose data gave nothing; it does not happen with the seeds of the tests, and says why if it does.
fn without(mut section: Section, why: impl std::fmt::Display) -> Section {
    section.words.push(format!("This run could not be identified: {why}."));
    section
}

pub(super) fn orders(seed: u64) -> Section {
    let samples = dipped(&LAGS, seed, (20.0, 4.0));
    let mut section = Section {
        name: "orders",
        title: "Identification from a step, and its order".to_owned(),
        words: vec![format!(
            "A simulated probe with lags of {} s ({} of the step) and {} s is dipped from 20 into 4 degrees, noise {SIGMA_K} K. One, two and three exponentials are fitted; the \
             least criterion of those whose shares all differ from zero is chosen.",
            LAGS[0].0, LAGS[0].1, LAGS[1].0
        )],
        header: header(&["order", "left over, rms [K]", "criterion", "lags [s]", "shares"]),
        ..Section::default()
    };
    let found = match identify(&samples) {
        Ok(found) => found,
        Err(error) => return without(section, error),
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
    section.note("order", found.order() as f64);
    for (j, (lag, truth)) in found.lags().iter().zip(LAGS).enumerate() {
        section.note(format!("lag_{}_s", j + 1), lag.time_constant_s);
        section.note(format!("lag_{}_sigma_s", j + 1), lag.time_constant_sigma_s);
        let sigmas = (lag.time_constant_s - truth.0) / lag.time_constant_sigma_s;
        section.note(format!("lag_{}_error_sigmas", j + 1), sigmas);
    }
    section.picture =
        Some((fit_picture(&found), "Above: the samples and the fits. Below: what each order leaves.".to_owned()));
    section
}

fn fit_picture(found: &IdentifiedStep) -> crate::figures::Plot {
    let mut above = vec![line("shown", shown(&found.samples))];
    let mut below = vec![];
    for candidate in &found.candidates {
        let response = &candidate.fit.response;
        let name = format!("order {}", response.lags.len());
        let fitted = found.samples.iter().map(|sample| (sample.at_s, response.value_at(sample.at_s)));
        let left = found.samples.iter().map(|sample| (sample.at_s, sample.value - response.value_at(sample.at_s)));
        below.push(line(&name, left.collect()));
        above.push(line(&name, fitted.collect()));
    }
    // The first panel's first curve has no partner below; a level keeps the colours of the orders alike.
    below.insert(0, level("nothing left", 0.0));
    temperatures("A step response and its exponentials", vec![above, below])
}

/// Settling to 10, 5 and 2 % of the step.
pub(super) const SHARES: [f64; 3] = [0.1, 0.05, 0.02];

fn settling(series: &[(f64, f64)], (before, after): (f64, f64)) -> [Option<f64>; 3] {
    let step = (after - before).abs();
    SHARES.map(|share| settled_after_s(series, DIPPED_S, (after, share * step)))
}

fn on_its_way(predictions: &[Prediction]) -> Vec<(f64, f64, f64)> {
    let moving = predictions.iter().filter(|prediction| prediction.is_on_its_way);
    moving.map(|p| (p.at_s, p.value, p.sigma)).collect()
}

pub(super) fn other_data(seed: u64) -> Section {
    let (taught, ends) = ((22.0, 8.0), (20.0, 4.0));
    let first = dipped(&LAGS, seed, taught);
    // Another day: less stirring, every lag is a fifth slower.
    let slower = LAGS.map(|(tau_s, share)| (1.2 * tau_s, share));
    let other = dipped(&slower, seed.wrapping_add(1), ends);
    let same = dipped(&LAGS, seed.wrapping_add(2), ends);
    let mut section = Section {
        name: "other_data",
        title: "Prediction on the same and on other data".to_owned(),
        words: vec![
            "The model is identified on one run and used on that run itself (data), on another one with the same dynamics (same), and on one in water that is stirred less, where every \
             lag is a fifth longer (other). Taken for certain, a wrong model is confidently wrong. Estimated along with the quantity (unknown dynamics), it is found out on the way. The \
             table has the seconds until within 10, 5 and 2 % of the step for good.".to_owned(),
        ],
        header: header(&["run", "method", "10 %", "5 %", "2 %"]),
        ..Section::default()
    };
    let models = match Models::of(&first) {
        Ok(models) => models,
        Err(why) => return without(section, why),
    };
    let mut panels = vec![];
    for (name, samples, ends) in [("data", &first, taught), ("same", &same, ends), ("other", &other, ends)] {
        let followed = models.follow(samples);
        followed.tell(&mut section, name, samples, ends);
        panels.push(followed.curves(samples, ends.1));
    }
    // The run that taught the model looks like its neighbour.
    panels.remove(0);
    let picture = temperatures("Another run, and another run in other water", panels);
    section.picture = Some((picture, "Above: the same dynamics. Below: every lag a fifth longer.".to_owned()));
    section
}

/// What one run says about the next: for certain, and as far as it can.
pub(super) struct Models {
    certain: Expectation,
    kind: Kind,
}

impl Models {
    pub(super) fn of(samples: &[Sample]) -> Result<Self, String> {
        let found = identify(samples).map_err(|error| error.to_string())?;
        let lags = found.lags();
        let lags: Vec<(f64, f64)> = lags.iter().map(|lag| (lag.time_constant_s, lag.share)).collect();
        let kind = Kind::of(&[found], Likeness::SameKind).map_err(|error| error.to_string())?;
        let certain = Expectation::known(&lags).ok_or("no lag was found")?;
        Ok(Self { certain, kind })
    }

    /// By the lags taken for certain, and with the lags estimated along.
    pub(super) fn predictions(&self, samples: &[Sample]) -> (Vec<Prediction>, Vec<Prediction>) {
        (predict_as_expected(samples, SIGMA_K, &self.certain), predict(samples, SIGMA_K, &self.kind))
    }

    fn follow(&self, samples: &[Sample]) -> Followed {
        let (certain, estimated) = self.predictions(samples);
        Followed { certain: on_its_way(&certain), estimated: on_its_way(&estimated) }
    }
}

/// Instants, values and sigmas by both.
struct Followed {
    certain: Vec<(f64, f64, f64)>,
    estimated: Vec<(f64, f64, f64)>,
}

impl Followed {
    fn tell(&self, section: &mut Section, name: &str, samples: &[Sample], ends: (f64, f64)) {
        for (method, series) in
            [("shown", shown(samples)), ("certain", values(&self.certain)), ("estimated", values(&self.estimated))]
        {
            let settled = settling(&series, ends);
            let cells = settled.map(seconds).to_vec();
            let names = vec![name.to_owned(), method.to_owned()];
            section.rows.push([names, cells].concat());
            for (share, settled) in ["10", "5", "2"].into_iter().zip(settled) {
                section.note(format!("{name}_{method}_{share}_percent_s"), settled);
            }
        }
    }

    fn curves(&self, samples: &[Sample], end: f64) -> Vec<crate::figures::Curve> {
        // The first seconds say nothing, with a band as wide as the picture.
        let later = |all: &[(f64, f64, f64)]| -> Vec<(f64, f64, f64)> {
            let told = all.iter().filter(|(_, _, sigma)| *sigma < 2.0);
            told.copied().collect()
        };
        let estimated = later(&self.estimated);
        vec![
            level("truth", end),
            line("certain", values(&later(&self.certain))),
            line("estimated", values(&estimated)),
            line("shown", shown(samples)),
            band("estimated, 95 %", &estimated),
        ]
    }
}

pub(super) fn both_ways(seed: u64) -> Section {
    let (warm, cold) = (50.0, 20.0);
    let (up, down) = ([(2.0, 1.0)], [(2.6, 1.0)]);
    let rising = dipped(&up, seed, (cold, warm));
    let falling = dipped(&down, seed.wrapping_add(1), (warm, cold));
    let mut section = Section {
        name: "both_ways",
        title: "Heating and cooling apart".to_owned(),
        words: vec![
            "Heat goes into a probe through another film of water than out of it. A simulated probe has 2.0 s on the way up and 2.6 s on the way down. Each way is identified apart; \
             a way of which there is no run is expected like the other, with a wider spread.".to_owned(),
        ],
        header: header(&["identified by", "expected of cooling [s]", "sigma of ln", "until within 5 % [s]"]),
        ..Section::default()
    };
    let found = [identify(&rising), identify(&falling)];
    let [Ok(up), Ok(down)] = found else {
        return without(section, "one of the two runs holds no step");
    };
    let next = dipped(&[(2.6, 1.0)], seed.wrapping_add(2), (warm, cold));
    for (name, runs) in [("heating", vec![up.clone()]), ("both", vec![up, down])] {
        let kind = match Kind::of(&runs, Likeness::SameKind) {
            Ok(kind) => kind,
            Err(error) => return without(section, error),
        };
        let Some(expected) = kind.expectation(super::super::Way::Down) else {
            return without(section, "nothing is expected of a way");
        };
        let lag = expected.dynamics.slowest();
        let predictions = on_its_way(&predict(&next, SIGMA_K, &kind));
        let settled = settled_after_s(&values(&predictions), DIPPED_S, (cold, 0.05 * (warm - cold)));
        section.rows.push(vec![
            name.to_owned(),
            format!("{:.2}", lag.mean.exp()),
            format!("{:.3}", lag.sigma),
            seconds(settled),
        ]);
        section.note(format!("by_{name}_expected_s"), lag.mean.exp());
        section.note(format!("by_{name}_sigma"), lag.sigma);
        section.note(format!("by_{name}_5_percent_s"), settled);
    }
    section
}
