//! Accelerometers at both wheels for a drive of `drive.rs`, which then stays as it is otherwise.

use posebridge_telemetry::{MetersPerSecondSquared, Observation, ObservationKind, SensorId, TimeDelta};
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64;

use super::drive::{Arrival, Drive, STEP_S, commands, stamp};
use super::robot::TRACK_M;

/// What an accelerometer at each wheel feels at each step, with white noise of `sigma` m/s²: the change of the wheel's mean speed
/// from the step before to the step after.
pub(crate) fn add_accelerations(drive: &mut Drive, laps: usize, sigma: f64, seed: u64) {
    let mut normals = Pcg64::seed_from_u64(seed ^ 0xacce1);
    let commands = commands(laps);
    let speeds: Vec<[f64; 2]> = commands
        .iter()
        .map(|(distance_m, turn_rad)| {
            let half_m = 0.5 * turn_rad * TRACK_M;
            [distance_m - half_m, distance_m + half_m].map(|travel_m| travel_m / STEP_S)
        })
        .collect();
    for (index, pair) in speeds.windows(2).enumerate() {
        let step = index + 1;
        let mut felt = |wheel: usize| {
            let noise: f64 = normals.sample(StandardNormal);
            MetersPerSecondSquared((pair[1][wheel] - pair[0][wheel]) / STEP_S + sigma * noise)
        };
        let observed = ObservationKind::WheelAccelerations { left: felt(0), right: felt(1) };
        let observation = Observation {
            sensor: SensorId::ACCELEROMETER,
            stamp: stamp(step),
            stamp_sigma: TimeDelta::ZERO,
            measurement: observed,
        };
        drive.arrivals.push(Arrival { step, observation });
    }
    drive.arrivals.sort_by_key(|arrival| arrival.step);
}
