//! The consistency figures over seeded draws: honest claims lie inside the chi-square band, others outside.

use posebridge_report::metrics::{VerdictTone, anees, nees};
use posebridge_report::{
    Consistency, ErrorSummary, FilterVerdict, PoseError, SourceTally, source_verdicts, summarise, tally_sources,
};
use posebridge_telemetry::{FusionOutcome, FusionRecord, SensorId, Timestamp};
use proptest::prelude::*;
use rand::SeedableRng as _;
use rand_distr::{Distribution as _, StandardNormal};
use rand_pcg::Pcg64Mcg;

use crate::record;
use crate::sample_run::normal;

const RUNS: u64 = 100;

/// A lower triangular factor of millimetres and milliradians, correlated.
const FACTOR: [[f64; 3]; 3] = [[0.004, 0.0, 0.0], [-0.002, 0.003, 0.0], [0.001, 0.004, 0.010]];

fn covariance(factor: &[[f64; 3]; 3], scale: f64) -> [[f64; 3]; 3] {
    std::array::from_fn(|row| {
        std::array::from_fn(|column| {
            let products = (0..3).map(|k| factor[row][k] * factor[column][k]);
            scale * products.sum::<f64>()
        })
    })
}

/// Errors of independent runs with the covariance of `FACTOR`, which claim `scale` times that.
fn errors_claiming(scale: f64) -> Vec<PoseError> {
    let mut random = Pcg64Mcg::seed_from_u64(2_001);
    (0..RUNS)
        .map(|_| {
            let unit: [f64; 3] = std::array::from_fn(|_| StandardNormal.sample(&mut random));
            let [dx_m, dy_m, heading_rad] = FACTOR.map(|row| row.iter().zip(unit).map(|(l, u)| l * u).sum());
            PoseError { dx_m, dy_m, heading_rad: Some(heading_rad), covariance: Some(covariance(&FACTOR, scale)) }
        })
        .collect()
}

#[test]
fn honest_claims_lie_inside_the_band_and_wrong_ones_on_the_right_side() {
    for (scale, verdict) in
        [(1.0, Consistency::Consistent), (0.5, Consistency::OverConfident), (2.0, Consistency::UnderConfident)]
    {
        let outcome = anees(&errors_claiming(scale));
        assert_eq!((outcome.samples, outcome.refused), (100, 0));
        let judged = FilterVerdict::new(&summarise(&errors_claiming(scale)), RUNS, Vec::new());
        assert_eq!(judged.finding, verdict, "claims {scale} times the truth: {outcome:?}");
    }
}

#[test]
fn innovations_of_an_honest_sensor_are_consistent_and_of_a_noisier_one_are_not() {
    for (sigmas, verdict) in
        [(1.0, Consistency::Consistent), (1.5, Consistency::OverConfident), (0.7, Consistency::UnderConfident)]
    {
        let mut random = Pcg64Mcg::seed_from_u64(31);
        let mut tally = SourceTally::new(SensorId::CAMERA);
        for _ in 0..500 {
            let nis = (0..2).map(|_| (sigmas * normal(&mut random)).powi(2)).sum();
            tally.add(&record(SensorId::CAMERA, FusionOutcome::Accepted, nis));
        }
        assert_eq!(tally.verdict().finding, verdict, "{:?}", tally.mean_nis_per_dof());
    }
}

#[test]
fn only_used_observations_enter_the_mean() {
    let mut tally = SourceTally::new(SensorId::CAMERA);
    tally.add(&record(SensorId::CAMERA, FusionOutcome::Accepted, 1.0));
    tally.add(&record(SensorId::CAMERA, FusionOutcome::Accepted, 5.0));
    tally.add(&record(SensorId::CAMERA, FusionOutcome::Gated, 400.0));
    tally.add(&record(SensorId::CAMERA, FusionOutcome::TooOld, 0.0));
    tally.add(&record(SensorId::CAMERA, FusionOutcome::Malformed, f64::NAN));
    assert_eq!(tally.mean_nis_per_dof(), Some(1.5));
    assert_eq!((tally.used, tally.gated, tally.too_old, tally.malformed), (2, 1, 1, 1));
    assert_eq!(tally.gated_share(), Some(1.0 / 3.0));
}

#[test]
fn an_innovation_that_is_not_a_number_does_not_poison_the_mean() {
    let mut tally = SourceTally::new(SensorId::GYRO);
    tally.add(&record(SensorId::GYRO, FusionOutcome::Accepted, f64::NAN));
    assert_eq!((tally.used, tally.mean_nis_per_dof()), (1, None));
    assert_eq!(tally.verdict().finding, Consistency::TooLittleData);
}

#[test]
fn tallies_come_in_the_order_of_the_sensors() {
    let records = [
        record(SensorId::CAMERA, FusionOutcome::Accepted, 2.0),
        record(SensorId::WHEELS, FusionOutcome::Rebased, 0.0),
        record(SensorId::CAMERA, FusionOutcome::PoseReset, 2.0),
    ];
    let tallies = tally_sources(&records);
    assert_eq!(tallies.iter().map(|tally| tally.sensor).collect::<Vec<_>>(), [SensorId::WHEELS, SensorId::CAMERA]);
    assert_eq!((tallies[0].rebased, tallies[1].reset_to), (1, 1));
}

/// A source of `count` innovations that are alternately this many standard deviations off, to either side in a fixed pattern.
fn source(sensor: SensorId, count: u32, sigmas: f64) -> SourceTally {
    let mut tally = SourceTally::new(sensor);
    for index in 0..count {
        // + + - -: neighbours are as often alike as opposed.
        let innovation = if index / 2 % 2 == 0 { sigmas } else { -sigmas };
        tally.add(&FusionRecord {
            innovation: [innovation, 0.0, 0.0],
            innovation_covariance: [[1.0, 0.0, 0.0], [0.0; 3], [0.0; 3]],
            nis: sigmas * sigmas,
            degrees_of_freedom: 1,
            ..FusionRecord::new(sensor, "fix", Timestamp::ZERO, FusionOutcome::Accepted)
        });
    }
    tally
}

/// With observations that the gate refused.
fn gated(mut tally: SourceTally, count: u32) -> SourceTally {
    for _ in 0..count {
        tally.add(&record(tally.sensor, FusionOutcome::Gated, 400.0));
    }
    tally
}

fn errors(anees: Option<f64>) -> ErrorSummary {
    ErrorSummary { anees, samples: 100, ..ErrorSummary::default() }
}

#[test]
fn the_truth_decides_and_a_source_that_disagrees_is_explained_in_the_same_line() {
    let sources = [source(SensorId::WHEELS, 400, 0.7), source(SensorId::CAMERA, 400, 1.0)];
    let verdict = FilterVerdict::new(&errors(Some(1.0)), 1, source_verdicts(&sources));
    assert_eq!(
        verdict.to_string(),
        "consistent: ANEES 1.00, due 0.07 to 3.12; more noise is set than wheels (NIS 0.49) has, and the pose does not suffer by it"
    );
    let verdict = FilterVerdict::new(&errors(Some(9.0)), 1, source_verdicts(&sources[1..]));
    assert_eq!((verdict.finding, verdict.tone()), (Consistency::OverConfident, VerdictTone::Bad));
    assert!(verdict.to_string().contains("no innovation shows it"), "{verdict}");
    let verdict = FilterVerdict::new(&errors(Some(1.0)), 1, source_verdicts(&[source(SensorId::CAMERA, 400, 2.0)]));
    assert!(verdict.to_string().contains("too little noise is set for camera (NIS 4.00)"), "{verdict}");
}

#[test]
fn without_truth_the_sources_decide() {
    let (good, over, under, few) = (
        source(SensorId::CAMERA, 400, 1.0),
        source(SensorId::GYRO, 400, 2.0),
        source(SensorId::WHEELS, 400, 0.5),
        source(SensorId::COMPASS, 3, 5.0),
    );
    let refused = |count| gated(source(SensorId::CAMERA, 400, 1.0), count);
    for (sources, finding, text) in [
        (vec![good, over, under], Consistency::OverConfident, "over-confident: by the innovations of gyro (NIS 4.00)"),
        (vec![good, under], Consistency::UnderConfident, "under-confident: by the innovations of wheels (NIS 0.25)"),
        (vec![good, few], Consistency::Consistent, "consistent: by the innovations of camera (NIS 1.00)"),
        (vec![few], Consistency::TooLittleData, "too little data: no truth, and no source"),
        // A fifth of 500, and one more.
        (
            vec![refused(100)],
            Consistency::Consistent,
            "consistent: by the innovations of camera (NIS 1.00); the gate refused 20 %",
        ),
        (vec![refused(101), under], Consistency::OverConfident, "over-confident: the gate refused 20 % of camera"),
        (vec![gated(few, 3)], Consistency::TooLittleData, "too little data: no truth, and no source"),
    ] {
        let verdict = FilterVerdict::new(&errors(None), 1, source_verdicts(&sources));
        assert_eq!(verdict.finding, finding);
        assert!(verdict.to_string().starts_with(text), "{verdict}");
    }
}

#[test]
fn a_broken_covariance_is_never_called_consistent() {
    let broken = ErrorSummary { refused_covariances: 1, ..errors(Some(1.0)) };
    let verdict = FilterVerdict::new(&broken, 20, Vec::new());
    assert_eq!(verdict.to_string(), "over-confident: 1 covariances are not positive definite");
}

proptest! {
    /// Whitening by the factor from which the covariance was made must give the plain sum of squares.
    #[test]
    fn the_normalised_error_undoes_the_factor(
        unit in prop::array::uniform3(-5.0..5.0_f64),
        diagonal in prop::array::uniform3(0.1..10.0_f64),
        below in prop::array::uniform3(-3.0..3.0_f64),
    ) {
        let factor = [
            [diagonal[0], 0.0, 0.0],
            [below[0], diagonal[1], 0.0],
            [below[1], below[2], diagonal[2]],
        ];
        let error = factor.map(|row| row.iter().zip(unit).map(|(l, u)| l * u).sum::<f64>());
        let value = nees(error, &covariance(&factor, 1.0));
        let expected: f64 = unit.iter().map(|u| u * u).sum();
        prop_assert!((value.unwrap() - expected).abs() < 1e-6 * (1.0 + expected));
    }
}
