//! The pose part of the link laboratory: the same lap over a link.

use anyhow::Result;
use posebridge_sim::impairment::LinkProfile;
use posebridge_sim::{ReceivedEstimate, Scenario, Steering};
use posebridge_telemetry::TimeDelta;

use crate::config::Config;
use crate::station::run_report::{SimulationTruth, errors};
use crate::virtual_station::{self, VirtualLink};

/// The lap that is driven.
const SCENARIO: &str = "square";
/// The share of delays and ages that a figure named p99 leaves out.
const TAIL_SHARE: f64 = 0.01;
/// Delays of each way that are combined with each of the other's.
const QUANTILE_SAMPLES: usize = 1_000;

/// What comes on top of a profile.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct LinkConditions {
    /// Probability that what is sent at once is lost, each way.
    pub(super) loss: f64,
    /// Delay of each way, ms.
    pub(super) delay_ms: f64,
    /// Rate error of the brick's clock, ppm.
    pub(super) skew_ppm: f64,
}

/// A link over which laps are driven.
pub(super) struct LinkCase {
    pub(super) name: String,
    pub(super) profile: LinkProfile,
    pub(super) conditions: LinkConditions,
    pub(super) seed: u64,
}

/// What one lap showed.
pub(super) struct LapResult {
    position_rms_m: Option<f64>,
    odometry_rms_m: Option<f64>,
    ages: Vec<TimeDelta>,
    to_station: Vec<TimeDelta>,
    to_brick: Vec<TimeDelta>,
    outages: u64,
}

/// What all laps of a case showed.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct PoseRow {
    pub(super) profile: String,
    pub(super) conditions: LinkConditions,
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
pub(super) fn drive_lap(case: &LinkCase, run: u32) -> Result<LapResult> {
    let seed = case.seed.wrapping_add(u64::from(run));
    let scenario = Scenario::bundled(SCENARIO)?.with_seed(seed).with_steering(Steering::Estimate);
    let config = Config::default().with_tag_of(&scenario);
    let link = VirtualLink {
        profile: case.profile.clone(),
        seed,
        extra_loss: case.conditions.loss,
        extra_delay_ms: case.conditions.delay_ms,
        brick_skew_ppm: Some(case.conditions.skew_ppm),
    };
    let driven = virtual_station::run_over_link(scenario, config.station_config()?, &link)?;
    let (estimate, odometry) = errors(&driven.collector, &SimulationTruth::from_simulation(&driven.simulation));
    let received = driven.simulation.received_estimates();
    Ok(LapResult {
        position_rms_m: estimate.position_rms_m,
        odometry_rms_m: odometry.position_rms_m,
        ages: ages(received),
        to_station: driven.delays_to_station,
        to_brick: driven.delays_to_brick,
        outages: driven.link.outages,
    })
}

/// How old each instant's first estimate was when the brick had it. A fix that comes late corrects an instant for which the brick
/// already has an estimate: that is no new instant, and its age says nothing about the link.
fn ages(received: &[ReceivedEstimate]) -> Vec<TimeDelta> {
    let mut latest = None;
    let mut ages = Vec::with_capacity(received.len());
    for estimate in received {
        if latest.is_none_or(|latest| estimate.estimate_time > latest) {
            latest = Some(estimate.estimate_time);
            ages.push(estimate.age());
        }
    }
    ages
}

/// One row of the table.
pub(super) fn summarise(case: &LinkCase, laps: &[LapResult]) -> PoseRow {
    let ages = sorted(laps, |lap| &lap.ages);
    let ways = [sorted(laps, |lap| &lap.to_station), sorted(laps, |lap| &lap.to_brick)];
    PoseRow {
        profile: case.name.clone(),
        conditions: case.conditions,
        position_rms_m: mean_square(laps, |lap| lap.position_rms_m),
        odometry_rms_m: mean_square(laps, |lap| lap.odometry_rms_m),
        age_p50_ms: quantile_ms(&ages, 0.5),
        age_p99_ms: quantile_ms(&ages, 1.0 - TAIL_SHARE),
        link_delay_p99_ms: round_trip_ms(&ways, 1.0 - TAIL_SHARE),
        outages: laps.iter().map(|lap| lap.outages).sum(),
    }
}

fn sorted(laps: &[LapResult], of: impl Fn(&LapResult) -> &Vec<TimeDelta>) -> Vec<TimeDelta> {
    let mut all: Vec<TimeDelta> = laps.iter().flat_map(|lap| of(lap).iter().copied()).collect();
    all.sort_unstable();
    all
}

fn quantile_ms(sorted: &[TimeDelta], share: f64) -> Option<f64> {
    let last = sorted.len().checked_sub(1)?;
    let index = (last as f64 * share).round() as usize;
    sorted.get(index).map(|span| span.as_millis_f64())
}

/// The quantile of the delay there and back, if each way had its delays independently of the other. A sum of both ways' quantiles would not
/// do: where one piece in a hundred stalls, one in fifty does there or back.
fn round_trip_ms(ways: &[Vec<TimeDelta>; 2], share: f64) -> Option<f64> {
    let [there, back] = ways.each_ref().map(|way| even_sample(way));
    let mut sums: Vec<TimeDelta> = there.iter().flat_map(|there| back.iter().map(move |back| *there + *back)).collect();
    sums.sort_unstable();
    quantile_ms(&sums, share)
}

/// Values at even steps through a sorted sample, enough that ten of them lie beyond the 99 % quantile.
fn even_sample(sorted: &[TimeDelta]) -> Vec<TimeDelta> {
    let step = |index: usize| sorted.get((2 * index + 1) * sorted.len() / (2 * QUANTILE_SAMPLES));
    (0..QUANTILE_SAMPLES).filter_map(step).copied().collect()
}

fn mean_square(laps: &[LapResult], of: impl Fn(&LapResult) -> Option<f64>) -> Option<f64> {
    let squares = laps.iter().map(|lap| of(lap).map(|rms| rms * rms));
    let sum = squares.sum::<Option<f64>>()?;
    (!laps.is_empty()).then(|| (sum / laps.len() as f64).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn case(profile: &str) -> LinkCase {
        LinkCase {
            name: profile.to_owned(),
            profile: LinkProfile::bundled(profile).unwrap(),
            conditions: LinkConditions { loss: 0.0, delay_ms: 0.0, skew_ppm: 20.0 },
            seed: 1,
        }
    }

    fn row(profile: &str) -> PoseRow {
        let case = case(profile);
        let laps: Vec<LapResult> = (0..2).map(|run| drive_lap(&case, run).unwrap()).collect();
        summarise(&case, &laps)
    }

    #[test]
    fn two_ways_that_stall_one_time_in_a_hundred_stall_together_one_time_in_fifty() {
        let mut way: Vec<TimeDelta> = vec![TimeDelta::from_millis(10); 1_000];
        way[990..].fill(TimeDelta::from_millis(100));
        let ways = [way.clone(), way];
        assert_eq!(round_trip_ms(&ways, 0.97), Some(20.0));
        assert_eq!(round_trip_ms(&ways, 0.99), Some(110.0));
        assert_eq!(round_trip_ms(&[Vec::new(), Vec::new()], 0.99), None);
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
