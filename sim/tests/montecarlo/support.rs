//! Scenarios that were changed, what a drive's sensors told, and how far a spread may be off.

use posebridge_sim::montecarlo::{Drive, SCENARIOS, Scenario};
use posebridge_telemetry::{Fix, ObservationKind};

pub(crate) const DEGREE: f64 = std::f64::consts::PI / 180.0;

pub(crate) fn bundled(name: &str) -> Scenario {
    Scenario::bundled(name).unwrap()
}

/// The bundled scenario with some of its text replaced.
pub(crate) fn changed(name: &str, changes: &[(&str, &str)]) -> Scenario {
    let (_, text) = SCENARIOS.iter().find(|(known, _)| *known == name).unwrap();
    let mut text = (*text).to_owned();
    for (from, to) in changes {
        assert!(text.contains(from), "{name} has no `{from}`");
        text = text.replace(from, to);
    }
    Scenario::from_toml(&text).unwrap()
}

/// Arrival step, stamp as a step, and content of every fix.
pub(crate) fn fixes(drive: &Drive) -> Vec<(usize, usize, Fix)> {
    let arrivals = drive.arrivals.iter().filter_map(|arrival| {
        let ObservationKind::Fix(fix) = arrival.observation.measurement else {
            return None;
        };
        let taken = arrival.observation.stamp.as_nanos() / drive.step.as_nanos();
        Some((arrival.step, usize::try_from(taken).unwrap(), fix))
    });
    arrivals.collect()
}

/// Errors of a fix: x, y and, where it has one, heading.
pub(crate) fn fix_errors(drive: &Drive) -> Vec<(f64, f64, Option<f64>)> {
    let errors = fixes(drive).into_iter().map(|(_, taken, fix)| {
        let truth = drive.truth[taken];
        (
            fix.position.x.0 - truth.x.0,
            fix.position.y.0 - truth.y.0,
            fix.heading.map(|heading| (heading - truth.heading).0),
        )
    });
    errors.collect()
}

/// What `of` takes from the observations, given the step at which each arrived.
fn observations_of<T>(drive: &Drive, of: impl Fn(usize, ObservationKind) -> Option<T>) -> Vec<T> {
    let arrivals = drive.arrivals.iter();
    let told = arrivals.filter_map(|arrival| of(arrival.step, arrival.observation.measurement));
    told.collect()
}

pub(crate) fn rates(drive: &Drive) -> Vec<(usize, f64)> {
    observations_of(drive, |step, observed| {
        let ObservationKind::TurnRate(rate) = observed else {
            return None;
        };
        Some((step, rate.0))
    })
}

/// Step and left and right rotation.
pub(crate) fn wheel_angles(drive: &Drive) -> Vec<(usize, f64, f64)> {
    observations_of(drive, |step, observed| {
        let ObservationKind::WheelAngles { left, right } = observed else {
            return None;
        };
        Some((step, left.0, right.0))
    })
}

/// Step and left and right acceleration.
pub(crate) fn accelerations(drive: &Drive) -> Vec<(usize, f64, f64)> {
    observations_of(drive, |step, observed| {
        let ObservationKind::WheelAccelerations { left, right } = observed else {
            return None;
        };
        Some((step, left.0, right.0))
    })
}

pub(crate) fn true_turn_rad(drive: &Drive, step: usize) -> f64 {
    (drive.truth[step].heading - drive.truth[step - 1].heading).0
}

pub(crate) fn rms(values: impl IntoIterator<Item = f64>) -> f64 {
    let (sum, count) = values.into_iter().fold((0.0, 0.0), |(sum, count), value| (sum + value * value, count + 1.0));
    f64::sqrt(sum / count)
}

/// Whether a root mean square over `count` draws fits `expected` within four standard deviations.
pub(crate) fn assert_sigma(found: f64, expected: f64, count: usize, what: &str) {
    let allowed = 4.0 * expected / (2.0 * count as f64).sqrt();
    assert!((found - expected).abs() < allowed, "{what}: {found} instead of {expected} +- {allowed}");
}
