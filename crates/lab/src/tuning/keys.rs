//! Tunable parameters: the noise of a robot (keys of `[robot.noise]`), and the positive tunables of a filter.

use posebridge_estimator::params::{PARAMS, Param};
use posebridge_estimator::{FilterConfig, Params};
use posebridge_telemetry::{Observation, ObservationKind, SensorNoise};

#[derive(Debug)]
pub struct NoiseKey {
    /// Key in `[robot.noise]`.
    pub key: &'static str,
    pub read: fn(&SensorNoise) -> f64,
    pub write: fn(&mut SensorNoise, f64),
    /// Whether an observation of this kind depends on it, so that it is tuned by default.
    observed_by: fn(&ObservationKind) -> bool,
}

macro_rules! noise_keys {
    ($($key:ident: $observed_by:expr;)+) => {
        /// Every noise of a robot, in the order of [`SensorNoise`].
        pub const NOISE_KEYS: &[NoiseKey] = &[$(NoiseKey {
            key: stringify!($key),
            read: |noise| noise.$key,
            write: |noise, value| noise.$key = value,
            observed_by: $observed_by,
        },)+];
        /// Fails to compile when [`SensorNoise`] gains a field without a line above.
        const _: fn(&SensorNoise) = |noise| {
            let SensorNoise { $($key: _,)+ } = *noise;
        };
    };
}

noise_keys! {
    wheel_travel_m_per_sqrt_m: |kind| matches!(kind, ObservationKind::WheelAngles { .. });
    travel_m_per_sqrt_m: is_motion_observation;
    turn_rad_per_sqrt_rad: is_motion_observation;
    heading_rad_per_sqrt_m: is_motion_observation;
    travel_m_per_sqrt_s: is_motion_observation;
    heading_rad_per_sqrt_s: is_motion_observation;
    gyro_rad_per_s: |kind| matches!(kind, ObservationKind::TurnRate(_));
    gyro_resolution_rad_per_s: |_| false;
    gyro_bias_rad_per_s: |_| false;
    gyro_bias_walk_rad_per_s_sqrt_s: |_| false;
    fix_position_m: |kind| matches!(kind, ObservationKind::Fix(fix) if fix.covariance.is_none());
    fix_heading_rad: |kind| matches!(kind, ObservationKind::Fix(fix) if fix.covariance.is_none() && fix.heading.is_some());
    fix_persistent_m: |_| false;
    fix_persistence_m: |_| false;
    accelerometer_m_per_s2: |_| false;
    compass_rad: |kind| matches!(kind, ObservationKind::CompassHeading(_));
    landmark_range_m: |kind| matches!(kind, ObservationKind::Landmark { .. });
    landmark_range_share: |kind| matches!(kind, ObservationKind::Landmark { .. });
    landmark_bearing_rad: |kind| matches!(kind, ObservationKind::Landmark { .. });
    landmark_place_m: |_| false;
    beacon_range_m: |kind| matches!(kind, ObservationKind::BeaconRange { .. });
    beacon_range_share: |kind| matches!(kind, ObservationKind::BeaconRange { .. });
    wall_range_m: |kind| matches!(kind, ObservationKind::WallRange(_));
    temperature_k: |kind| matches!(kind, ObservationKind::Temperature(_));
}

const fn is_motion_observation(kind: &ObservationKind) -> bool {
    matches!(
        kind,
        ObservationKind::WheelAngles { .. } | ObservationKind::OdometerPose(_) | ObservationKind::BodyVelocity { .. }
    )
}

#[derive(Clone, Copy)]
pub enum TunedKey {
    Noise(&'static NoiseKey),
    Param(&'static Param),
}

#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{key}` cannot be tuned; there are {known}, and filter.KEY for the tunables of `[filter]`")]
pub struct UnknownKey {
    key: String,
    known: String,
}

impl TunedKey {
    /// Parses a key: `fix_position_m`, `noise.fix_position_m`, `robot.noise.fix_position_m` or `filter.accel_m_s2`.
    pub fn from_name(text: &str) -> Result<Self, UnknownKey> {
        let found = if let Some(key) = text.strip_prefix("filter.") {
            PARAMS.iter().find(|row| row.key == key).map(Self::Param)
        } else {
            let key = text.strip_prefix("robot.").unwrap_or(text);
            let key = key.strip_prefix("noise.").unwrap_or(key);
            let mut rows = NOISE_KEYS.iter();
            rows.find(|row| row.key == key).map(Self::Noise)
        };
        found.ok_or_else(|| UnknownKey {
            key: text.to_owned(),
            known: NOISE_KEYS.iter().map(|row| row.key).collect::<Vec<_>>().join(", "),
        })
    }

    /// As in a configuration, below the robot or the filter: `noise.fix_position_m`, `filter.accel_m_s2`.
    pub fn name(&self) -> String {
        match self {
            Self::Noise(row) => format!("noise.{}", row.key),
            Self::Param(row) => format!("filter.{}", row.key),
        }
    }

    pub fn read(&self, config: &FilterConfig) -> f64 {
        match self {
            Self::Noise(row) => (row.read)(&config.noise),
            Self::Param(row) => (row.read)(&config.params),
        }
    }

    /// Multiplies the parameter; a tunable is clamped to its range.
    pub fn scale(&self, config: &mut FilterConfig, factor: f64) {
        match self {
            Self::Noise(row) => {
                let value = (row.read)(&config.noise);
                (row.write)(&mut config.noise, value * factor);
            }
            Self::Param(row) => scale_param(row, &mut config.params, factor),
        }
    }
}

fn scale_param(row: &Param, params: &mut Params, factor: f64) {
    let value = (row.read)(params) * factor;
    (row.write)(params, value.clamp(*row.range.start(), *row.range.end()));
}

/// Default selection: the noises above zero that the observations determine.
pub fn default_keys(observations: &[Observation], noise: &SensorNoise) -> Vec<TunedKey> {
    let is_observed = |row: &NoiseKey| {
        let mut observations = observations.iter();
        observations.any(|observation| (row.observed_by)(&observation.measurement))
    };
    NOISE_KEYS.iter().filter(|row| (row.read)(noise) > 0.0 && is_observed(row)).map(TunedKey::Noise).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_is_found_under_every_way_to_write_it_and_an_unknown_one_lists_the_others() {
        for text in ["gyro_rad_per_s", "noise.gyro_rad_per_s", "robot.noise.gyro_rad_per_s"] {
            assert_eq!(TunedKey::from_name(text).unwrap().name(), "noise.gyro_rad_per_s");
        }
        let filter = TunedKey::from_name("filter.accel_m_s2").unwrap();
        assert_eq!(filter.name(), "filter.accel_m_s2");
        let message = TunedKey::from_name("noise.gyro").err().unwrap().to_string();
        assert!(message.contains("`noise.gyro`") && message.contains("fix_heading_rad"), "{message}");
    }

    #[test]
    fn every_row_reads_what_it_writes_and_nothing_else() {
        for (index, row) in NOISE_KEYS.iter().enumerate() {
            let mut noise = SensorNoise::EXACT;
            (row.write)(&mut noise, 2.0);
            for (other_index, other) in NOISE_KEYS.iter().enumerate() {
                let expected = if index == other_index { 2.0 } else { (other.read)(&SensorNoise::EXACT) };
                assert_eq!((other.read)(&noise), expected, "{} {}", row.key, other.key);
            }
        }
    }

    #[test]
    fn a_tunable_is_scaled_within_its_range() {
        let row = PARAMS.iter().find(|row| row.key == "accel_m_s2").unwrap();
        let mut params = Params::default();
        scale_param(row, &mut params, 2.0);
        assert_eq!(params.acceleration_m_per_s2, 2.0);
        scale_param(row, &mut params, 1e9);
        assert_eq!(params.acceleration_m_per_s2, *row.range.end());
    }
}
