//! Accelerometers on a robot's frame, at both ends of the nominal axle, for a drive of [`montecarlo`](crate::montecarlo), whose own ones
//! sit on the wheels: fixed to the frame, their lever arm in a turn is known from a ruler.
//!
//! # Model
//! ```text
//! s_k, w_k   true mean speed and turn rate over step k, both constant within it
//! a_k = (s_(k+1) - s_k) / dt      alpha_k alike: the mean from the middle of step k to that of the next, stamped there
//! left = a - b alpha / 2 + bias_l + sigma n      right = a + b alpha / 2 + bias_r + sigma n      b the nominal track
//! ```
//! Half a step out of phase with the encoders the double sums are exactly the true travel and turn: a drive's speed changes only at the
//! ends of its steps.

use posebridge_telemetry::{
    Arena, Meters, MetersPerSecondSquared, Observation, ObservationKind, Pose, SensorId, TimeDelta,
};

use crate::montecarlo::{Arrival, Drive};
use crate::random::RandomStream;

/// Accelerometers at both ends of the nominal axle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameAccelerometers {
    pub sigma_m_per_s2: f64,
    /// Each one's bias, constant over a drive.
    pub bias_sigma_m_per_s2: f64,
    pub spacing: Meters,
}

impl FrameAccelerometers {
    /// Replaces the accelerometers of a drive; run `run` of `seed` draws its own noise.
    pub fn add_to(&self, mut drive: Drive, seed: u64, run: u32) -> Drive {
        let felt = self.sample(&drive, seed, run);
        drive.arrivals.retain(|arrival| arrival.observation.sensor != SensorId::ACCELEROMETER);
        drive.arrivals.extend(felt);
        // Of one step they come before the wheels, so that these can be held against them.
        let sort_key = |arrival: &Arrival| {
            let is_wheels = arrival.observation.sensor == SensorId::WHEELS;
            (arrival.step, is_wheels)
        };
        drive.arrivals.sort_by_key(sort_key);
        drive
    }

    fn sample(&self, drive: &Drive, seed: u64, run: u32) -> Vec<Arrival> {
        let dt_s = drive.step.as_secs_f64();
        let mut noise = RandomStream::new(seed, &format!("frame accelerometers {run}"));
        let biases = [(); 2].map(|()| self.bias_sigma_m_per_s2 * noise.normal());
        let mut speeds = vec![(0.0, 0.0)];
        speeds.extend(drive.truth.windows(2).map(|pair| mean_speeds(pair, dt_s)));
        let half_a_step = TimeDelta::from_nanos(drive.step.as_nanos() / 2);
        let changes = speeds.windows(2).enumerate();
        changes
            .map(|(step, pair)| {
                let forward = (pair[1].0 - pair[0].0) / dt_s;
                let turn = (pair[1].1 - pair[0].1) / dt_s;
                let lever = 0.5 * self.spacing.0 * turn;
                let [left, right] = [(forward - lever, biases[0]), (forward + lever, biases[1])]
                    .map(|(felt, bias)| felt + bias + self.sigma_m_per_s2 * noise.normal());
                Arrival {
                    step: step + 1,
                    measured_step: step + 1,
                    observation: Observation {
                        sensor: SensorId::ACCELEROMETER,
                        stamp: drive.time_at(step) + half_a_step,
                        stamp_sigma: TimeDelta::ZERO,
                        measurement: ObservationKind::WheelAccelerations {
                            left: MetersPerSecondSquared(left),
                            right: MetersPerSecondSquared(right),
                        },
                    },
                }
            })
            .collect()
    }
}

/// Forward speed and turn rate over a step, from its true poses: the arc over the chord.
fn mean_speeds(pair: &[Pose<Arena>], dt_s: f64) -> (f64, f64) {
    let (from, to) = (pair[0], pair[1]);
    let turn_rad = (to.heading - from.heading).0;
    let middle_rad = from.heading.rad() + 0.5 * turn_rad;
    let (sin, cos) = middle_rad.sin_cos();
    let chord_m = (to.x - from.x).0 * cos + (to.y - from.y).0 * sin;
    let half = 0.5 * turn_rad;
    let per_chord = if half.abs() < 1e-6 { 1.0 } else { half / half.sin() };
    (chord_m * per_chord / dt_s, turn_rad / dt_s)
}

#[cfg(test)]
mod tests {
    use crate::montecarlo::Scenario;

    use super::*;

    /// A drive that ends at rest: the last sample reaches to the middle of the last step only.
    fn drive() -> Drive {
        let text = include_str!("../../config/scenarios/lab/indirect.toml");
        assert!(text.contains("rest_after_lap_s = 0.0"));
        Scenario::from_toml(&text.replace("rest_after_lap_s = 0.0", "rest_after_lap_s = 0.5")).unwrap().drive(0)
    }

    fn accelerations(drive: &Drive) -> Vec<(f64, f64)> {
        let kinds = drive.arrivals.iter().map(|arrival| arrival.observation.measurement);
        let both = |kind| {
            if let ObservationKind::WheelAccelerations { left, right } = kind { Some((left.0, right.0)) } else { None }
        };
        kinds.filter_map(both).collect()
    }

    #[test]
    fn without_noise_their_integrals_are_the_way_and_the_turns() {
        let exact = FrameAccelerometers { sigma_m_per_s2: 0.0, bias_sigma_m_per_s2: 0.0, spacing: Meters(0.112) };
        let drive = exact.add_to(drive(), 1, 0);
        let dt_s = 0.05;
        let (mut speed, mut turn_rate, mut distance, mut turn) = (0.0, 0.0, 0.0, 0.0);
        for (left, right) in accelerations(&drive) {
            let (a, alpha) = (0.5 * (left + right), (right - left) / 0.112);
            distance += speed * dt_s + 0.5 * a * dt_s * dt_s;
            turn += turn_rate * dt_s + 0.5 * alpha * dt_s * dt_s;
            speed += a * dt_s;
            turn_rate += alpha * dt_s;
        }
        let per_step = drive.truth.windows(2).map(|pair| mean_speeds(pair, dt_s));
        let (true_distance, true_turn) =
            per_step.fold((0.0, 0.0), |(distance, turn), (v, w)| (distance + dt_s * v, turn + dt_s * w));
        assert!(speed.abs() < 1e-9, "{speed}");
        assert!((distance - true_distance).abs() < 1e-9, "{distance} {true_distance}");
        assert!((turn - true_turn).abs() < 1e-9, "{turn} {true_turn}");
        // Four sides, and four turns with one more.
        assert!((true_distance - 12.0).abs() < 0.2 && (true_turn - 7.85).abs() < 0.6);
    }

    #[test]
    fn they_replace_the_others_with_noise_of_their_own_in_each_run() {
        let settings = FrameAccelerometers { sigma_m_per_s2: 0.012, bias_sigma_m_per_s2: 0.05, spacing: Meters(0.112) };
        let mounted = |run| accelerations(&settings.add_to(drive(), 1, run));
        assert_eq!(mounted(0).len(), accelerations(&drive()).len());
        assert_eq!(mounted(0), mounted(0));
        assert_ne!(mounted(0), mounted(1));
    }
}
