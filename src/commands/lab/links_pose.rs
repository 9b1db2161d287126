//! The pose part of the link laboratory: the same lap over a link.

use anyhow::Result;
use posebridge_sim::impairment::LinkProfile;
use posebridge_sim::{ReceivedEstimate, Scenario, Steering};
use posebridge_telemetry::Span;

use crate::config::Config;
use crate::report::run::{Truth, errors};
use crate::virtual_run::{self, VirtualLink};

/// The lap that is driven.
const SCENARIO: &str = "square";
/// The share of delays and ages that a figure named p99 leaves out.
const TAIL: f64 = 0.01;
/// Delays of each way that are combined with each of the other's.
const SAMPLED: usize = 1_000;

/// What comes on top of a profile.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Circumstance {
    /// Probability that what is sent at once is lost, each way.
    pub(super) loss: f64,
    /// Delay of each way, ms.
    pub(super) delay_ms: f64,
    /// Rate error of the brick's clock, ppm.
    pub(super) skew_ppm: f64,
}

/// A link over which laps are driven.
pub(super) struct Case {
    pub(super) name: String,
    pub(super) profile: LinkProfile,
    pub(super) circumstance: Circumstance,
    pub(super) seed: u64,
}

/// What one lap showed.
pub(super) struct Lap {
    position_rms_m: Option<f64>,
    odometry_rms_m: Option<f64>,
    ages: Vec<Span>,
    to_station: Vec<Span>,
    to_brick: Vec<Span>,
    outages: u64,
}

/// What all laps of a case showed.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct PoseRow {
    pub(super) profile: String,
    pub(super) circumstance: Circumstance,
    /// Root of the mean over the laps of the squared error, m; `None` when some lap had no estimate.
    pub(super) position_rms_m: Option<f64>,
    /// The same of the brick's own odometry, m.
    pub(super) odometry_rms_m: Option<f64>,
    /// Age of the estimates when the brick had them, ms.
    pub(super) age_p50_ms: Option<f64>,
    /// The same, exceeded by one in a hundred.
    pub(super) age_p99_ms: Option<f64>,
    /// The delay there and back, exceeded by one pair of pieces in a hundred, ms.
    pub(super) link_delay_p99_ms: Option<f64>,
    /// Times the link went down, in all laps.
    pub(super) outages: u64,
}

/// Drives one lap; world and link differ from run to run, and are the same for every case.
pub(super) fn drive(case: &Case, run: u32) -> Result<Lap> {
    let seed = case.seed.wrapping_add(u64::from(run));
    let scenario = Scenario::bundled(SCENARIO)?.with_seed(seed).with_steering(Steering::Estimate);
    let config = Config::default().with_tag_of(&scenario);
    let link = VirtualLink {
        profile: case.profile.clone(),
        seed,
        extra_loss: case.circumstance.loss,
        extra_delay_ms: case.circumstance.delay_ms,
        brick_skew_ppm: Some(case.circumstance.skew_ppm),
    };
    let driven = virtual_run::run_over(scenario, config.pipeline()?, &link)?;
    let (estimate, odometry) = errors(&driven.collector, &Truth::of(&driven.simulation));
    let received = driven.simulation.received_estimates();
    Ok(Lap {
        position_rms_m: estimate.position_rms_m,
        odometry_rms_m: odometry.position_rms_m,
        ages: ages(received),
        to_station: driven.delays_to_station,
        to_brick: driven.delays_to_brick,
        outages: driven.link.outages,
    })
}

/// How old each instant's first estimate was when the brick had it. A fix that comes late mends the estimate of an instant of which the
/// brick has already been told: that is no new instant, and its age says nothing about the link.
fn ages(received: &[ReceivedEstimate]) -> Vec<Span> {
    let mut told = None;
    let mut ages = Vec::with_capacity(received.len());
    for estimate in received {
        if told.is_none_or(|told| estimate.instant > told) {
            told = Some(estimate.instant);
            ages.push(estimate.age());
        }
    }
    ages
}

/// One row of the table.
pub(super) fn summarise(case: &Case, laps: &[Lap]) -> PoseRow {
    let ages = sorted(laps, |lap| &lap.ages);
    let ways = [sorted(laps, |lap| &lap.to_station), sorted(laps, |lap| &lap.to_brick)];
    PoseRow {
        profile: case.name.clone(),
        circumstance: case.circumstance,
        position_rms_m: mean_square(laps, |lap| lap.position_rms_m),
        odometry_rms_m: mean_square(laps, |lap| lap.odometry_rms_m),
        age_p50_ms: quantile_ms(&ages, 0.5),
        age_p99_ms: quantile_ms(&ages, 1.0 - TAIL),
        link_delay_p99_ms: there_and_back_ms(&ways, 1.0 - TAIL),
        outages: laps.iter().map(|lap| lap.outages).sum(),
    }
}

fn sorted(laps: &[Lap], of: impl Fn(&Lap) -> &Vec<Span>) -> Vec<Span> {
    let mut all: Vec<Span> = laps.iter().flat_map(|lap| of(lap).iter().copied()).collect();
    all.sort_unstable();
    all
}

fn quantile_ms(sorted: &[Span], share: f64) -> Option<f64> {
    let last = sorted.len().checked_sub(1)?;
    let index = (last as f64 * share).round() as usize;
    sorted.get(index).map(|span| span.as_millis_f64())
}

/// The quantile of the delay there and back, if each way had its delays independently of the other. A sum of both ways' quantiles would not
/// do: where one piece in a hundred stalls, one in fifty does there or back.
fn there_and_back_ms(ways: &[Vec<Span>; 2], share: f64) -> Option<f64> {
    let [there, back] = ways.each_ref().map(|way| even_sample(way));
    let mut sums: Vec<Span> = there.iter().flat_map(|there| back.iter().map(move |back| *there + *back)).collect();
    sums.sort_unstable();
    quantile_ms(&sums, share)
}

/// Values at even steps through a sorted sample, so many that a quantile of 99 % is one of ten beyond it.
fn even_sample(sorted: &[Span]) -> Vec<Span> {
    let step = |index: usize| sorted.get((2 * index + 1) * sorted.len() / (2 * SAMPLED));
    (0..SAMPLED).filter_map(step).copied().collect()
}

fn mean_square(laps: &[Lap], of: impl Fn(&Lap) -> Option<f64>) -> Option<f64> {
    let squares = laps.iter().map(|lap| of(lap).map(|rms| rms * rms));
    let sum = squares.sum::<Option<f64>>()?;
    (!laps.is_empty()).then(|| (sum / laps.len() as f64).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn case(profile: &str) -> Case {
        Case {
            name: profile.to_owned(),
            profile: LinkProfile::bundled(profile).unwrap(),
            circumstance: Circumstance { loss: 0.0, delay_ms: 0.0, skew_ppm: 20.0 },
            seed: 1,
        }
    }

    fn row(profile: &str) -> PoseRow {
        let case = case(profile);
        let laps: Vec<Lap> = (0..2).map(|run| drive(&case, run).unwrap()).collect();
        summarise(&case, &laps)
    }

    #[test]
    fn two_ways_that_stall_one_time_in_a_hundred_stall_together_one_time_in_fifty() {
        let mut way: Vec<Span> = vec![Span::from_millis(10); 1_000];
        way[990..].fill(Span::from_millis(100));
        let ways = [way.clone(), way];
        assert_eq!(there_and_back_ms(&ways, 0.97), Some(20.0));
        assert_eq!(there_and_back_ms(&ways, 0.99), Some(110.0));
        assert_eq!(there_and_back_ms(&[Vec::new(), Vec::new()], 0.99), None);
    }

    #[test]
    fn bluetooth_costs_little_accuracy_and_an_estimate_is_no_older_than_its_link() {
        let (usb, bluetooth, wifi) = (row("usb"), row("bluetooth-spp"), row("wifi"));
        println!("{usb:?}\n{bluetooth:?}");
        let ratio = bluetooth.position_rms_m.unwrap() / usb.position_rms_m.unwrap();
        assert!(ratio < 1.2, "{ratio}");
        for row in [usb, bluetooth, wifi] {
            let limit_ms = row.link_delay_p99_ms.unwrap() + 5.0;
            assert!(row.age_p99_ms.unwrap() < limit_ms, "{row:?}");
        }
    }
}
