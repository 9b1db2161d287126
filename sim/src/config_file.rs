//! Configuration files in strict TOML: scenarios, wall scenes, link profiles, and the ranges of their numbers. The caller reads them from
//! disk.

use std::io;
use std::path::PathBuf;

use serde::de::{DeserializeOwned, DeserializeSeed, Deserializer, Error, IgnoredAny, MapAccess, SeqAccess, Visitor};

pub(crate) const LARGEST: f64 = 1e6;
/// Lower bound of sizes that must not be zero.
pub(crate) const SMALLEST: f64 = 1e-6;
/// Bounds the list of manoeuvres.
pub(crate) const MAX_LAPS: u32 = 10_000;
pub(crate) const LAST_VEHICLE_SYSTEM: u8 = 250;
pub const MAX_RUNS: u32 = 100_000;
/// Ten minutes; no real link delays a byte longer.
pub(crate) const LONGEST_MS: f64 = 600_000.0;
/// A table with the keys of a robot profile, which have ranges of their own.
const FOREIGN_TABLE: &str = "profile";
const LARGEST_BUFFER: f64 = 16.0 * 1024.0 * 1024.0;

/// Lowest and highest number of every key of a number. A key has the same range in all files.
///
/// The ranges are wide: they keep the physics finite and the memory bounded, they do not assess a design.
const RANGES: &[(f64, f64, &str)] = &[
    (
        0.0,
        LARGEST,
        "backlash_deg battery_drop_v_per_min bias_sigma_deg_per_s bias_sigma_m_per_s2 bias_walk_deg_per_s_sqrt_s
         dipped_at_s friction_n_m from_s heading_gain heading_sigma_deg integral_most_m_s jitter_ms kicks_per_min
         latency_ms lateral_gain_rad_per_m least_deg mass_kg most_deg most_turn_rad outlier_sigma_deg outlier_sigma_m
         patch_sigma_m pause_s position_sigma_m quantum_deg_per_s quantum_m_per_s2 resolution_deg_per_s resolution_k
         rest_after_lap_s rest_after_side_s rest_after_turn_s rest_s score_from_s sigma_deg_per_s sigma_k sigma_m
         sigma_m_per_s2 sigma_m_rad sigma_share slip_events_per_min start_heading_off_deg start_heading_sigma_rad
         start_position_sigma_m to_s true_noise_factor turn_rad_per_sqrt_rad wheel_travel_m_per_sqrt_m",
    ),
    // The Monte-Carlo scenarios' own.
    (
        0.0,
        LARGEST,
        "anees_least anees_most bearing_sigma_deg bias_sigma_m carry_s counts first_s fixes_gated_after_slips lasts_s least_m map_sigma_m
         most_m offset_sigma_m range_sigma_m recovery_s resets rms_m rms_per_bound rms_per_undisturbed sigma",
    ),
    (SMALLEST, LARGEST, "every_s max_range_m size_m"),
    (-LARGEST, LARGEST, "offset_m positions_m value"),
    (0.0, 360.0, "field_of_view_deg"),
    // The rendered camera's own. Pictures fit into the memory, and the detector takes pictures of this size.
    (64.0, 2_048.0, "height_px width_px"),
    (0.0, 100.0, "height_m"),
    (0.0, 80.0, "tilt_deg"),
    (-360.0, 360.0, "azimuth_deg"),
    (10.0, 100_000.0, "focal_px"),
    (-10.0, 10.0, "radial"),
    (-1_000.0, 1_000.0, "axis_offset_px"),
    (0.0, 1_000.0, "exposure_ms line_time_us"),
    (0.0, 10.0, "blur_px shot_noise"),
    (1.0, 255.0, "white_level"),
    (-1.0, 1.0, "light_change"),
    (0.0, 100.0, "read_noise"),
    (1.0, 100.0, "jpeg_quality"),
    // Of the family tag36h11.
    (0.0, 586.0, "id"),
    // Any seed; what has a check of its own.
    (f64::NEG_INFINITY, f64::INFINITY, "seed points_m lags_s shares"),
    (
        SMALLEST,
        LARGEST,
        "acceleration_m_per_s2 back_emf_v_s_per_rad battery_v cutoff_m duration_s fast_pwm inertia_kg_m2 longest_s most_pwm patch_size_m
         period_s
         pwm radius_m range_deg_per_s reference_pwm rise_90_s side_m speed_m_per_s stale_after_s start_m steady_m_per_s step_s
         still_m_per_s straight_m tangent_scale target_m tick_deg torque_n_m_per_v track_width_m tuned_kp_pwm_per_m turn_rate_rad_per_s
         turns wheel_radius_m wheel_turns",
    ),
    (
        -LARGEST,
        LARGEST,
        "heading_deg kd_pwm_s_per_m ki_pwm_per_m_s kp_pwm_per_m poses_m_deg tag_x_m tag_y_m turn_amplitude_rad_per_s
         turn_pulsation_rad_per_s wall_x_m x_m y_m",
    ),
    (
        0.0,
        1.0,
        "byte_loss dropout duplicate loss loss_bad loss_good miss_probability outlier probability probability_per_s range_share",
    ),
    // Where a bit carries no information; relative errors; so that every period is positive.
    (0.0, 0.5, "bit_error_rate"),
    (-0.5, 0.5, "radius_error radius_mismatch scale_error track_error"),
    (0.0, 0.5, "period_spread"),
    // So that a draw keeps every length positive.
    (
        0.0,
        0.1,
        "radius_difference_sigma radius_error_sigma radius_mismatch_sigma radius_scale_sigma scale_error_sigma scale_sigma
         track_error_sigma track_scale_sigma",
    ),
    // A tenth, in parts per million.
    (-1e5, 1e5, "clock_skew_ppm"),
    // At most the world's step.
    (0.01, 200.0, "rate_hz telemetry_hz"),
    // What both thermometer messages can carry.
    (-270.0, 320.0, "after_c before_c"),
    (0.0, 1e4, "turn_around_ms"),
    (0.1, 3_600.0, "program_restart_s"),
    (0.0, LONGEST_MS, "base_ms from_ms jitter_mean_ms to_ms"),
    (0.01, LONGEST_MS, "slot_ms"),
    (1e-3, 1e6, "down_from_s down_to_s mean_bad_s mean_good_s mean_up_s"),
    (1.0, 1e9, "bytes_per_s"),
    (1.0, LARGEST_BUFFER, "buffer_bytes"),
    (0.0, LARGEST_BUFFER, "burst_bytes"),
    (1.0, 65_535.0, "most_bytes"),
    (1.0, MAX_RUNS as f64, "runs"),
    (1.0, MAX_LAPS as f64, "laps"),
    (1.0, 100_000.0, "every_steps spread_steps"),
    // All fixes in transit are kept in memory.
    (0.0, 1_000.0, "delay_spread_steps delay_steps ramp_steps"),
    (1.0, 1_000.0, "report_every"),
    // 48 bits, so that nanoseconds fit into 64.
    (0.0, ((1_u64 << 48) - 1) as f64, "clock_start_micros"),
    (1.0, 1e6, "clock_tick_micros"),
    (1.0, LAST_VEHICLE_SYSTEM as f64, "system"),
    // Large enough for every documented telegram, no larger than the buffer of any NXT firmware.
    (64.0, 128.0, "telegram_bytes"),
];

/// The range of another key, such as that of a table, is never used: the numbers below it have keys of their own.
fn range_of(key: &str) -> (f64, f64) {
    let found = RANGES.iter().find(|(_, _, keys)| keys.split_whitespace().any(|ranged| ranged == key));
    found.map_or((0.0, LARGEST), |(low, high, _)| (*low, *high))
}

/// Why a configuration file was rejected. `what` names the kind of file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ConfigFileError {
    /// Invalid TOML, an unknown or missing key, or a value out of range; the message shows the line and the key.
    #[error("{what} is not usable: {error}")]
    Toml { what: &'static str, error: toml::de::Error },
    #[error("{what} is not usable: {reason}")]
    Impossible { what: &'static str, reason: String },
    #[error("no {what} is called \"{name}\"; there are {known}")]
    UnknownName {
        what: &'static str,
        name: String,
        /// All names, joined by commas.
        known: String,
    },
    /// Reading the file of way-points failed.
    #[error("scenario is not usable: line {line}: way-points in {} cannot be read: {source}", file.display())]
    WaypointsUnread {
        /// Line of the scenario that names the file, from 1.
        line: usize,
        /// As the scenario names it.
        file: PathBuf,
        source: io::Error,
    },
    /// An invalid line in the file of way-points.
    #[error("way-points are not usable: {}, line {line}: {reason}", file.display())]
    WaypointsFile {
        /// As the scenario names it.
        file: PathBuf,
        /// Line of that file, from 1; its last one if way-points are missing.
        line: usize,
        reason: String,
    },
    /// MAVLink has too few system ids for the vehicles.
    #[error("{count} robots from system {first} on are too many: at most {most}")]
    TooManyRobots { count: u8, first: u8, most: u8 },
}

/// `contradiction` says which values contradict each other, and why.
pub(crate) fn from_toml<T: DeserializeOwned>(
    what: &'static str,
    text: &str,
    contradiction: impl FnOnce(&T) -> Option<String>,
) -> Result<T, ConfigFileError> {
    let read = toml::from_str(text).and_then(|value| check_ranges(text).map(|()| value));
    let value = read.map_err(|error| ConfigFileError::Toml { what, error })?;
    match contradiction(&value) {
        None => Ok(value),
        Some(reason) => Err(ConfigFileError::Impossible { what, reason }),
    }
}

/// The error carries the line and the key of the first number that is out of range; a NaN is in no range.
pub(crate) fn check_ranges(text: &str) -> Result<(), toml::de::Error> {
    RangeCheck { low: 0.0, high: LARGEST }.deserialize(toml::Deserializer::parse(text)?)
}

/// Checks one value, or all values in a table or array, as the parser passes by: its errors know the line.
#[derive(Clone, Copy)]
struct RangeCheck {
    low: f64,
    high: f64,
}

impl<'de> DeserializeSeed<'de> for RangeCheck {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for RangeCheck {
    type Value = ();

    fn expecting(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str("a value")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut table: A) -> Result<(), A::Error> {
        while let Some(key) = table.next_key::<String>()? {
            if key == FOREIGN_TABLE {
                table.next_value::<IgnoredAny>()?;
                continue;
            }
            let (low, high) = range_of(&key);
            table.next_value_seed(Self { low, high })?;
        }
        Ok(())
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut array: A) -> Result<(), A::Error> {
        while array.next_element_seed(self)?.is_some() {}
        Ok(())
    }

    fn visit_f64<E: Error>(self, value: f64) -> Result<(), E> {
        if self.low <= value && value <= self.high {
            return Ok(());
        }
        Err(E::custom(format!("{value} is outside {} to {}; give a number in that range", self.low, self.high)))
    }

    fn visit_i64<E: Error>(self, value: i64) -> Result<(), E> {
        self.visit_f64(value as f64)
    }

    fn visit_u64<E: Error>(self, value: u64) -> Result<(), E> {
        self.visit_f64(value as f64)
    }

    fn visit_bool<E: Error>(self, _: bool) -> Result<(), E> {
        Ok(())
    }

    fn visit_str<E: Error>(self, _: &str) -> Result<(), E> {
        Ok(())
    }
}

/// Name and text of the files of a folder of `config/`.
macro_rules! bundle {
    ($folder:literal: $($name:literal),* $(,)?) => {
        &[$(($name, include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../config/", $folder, "/", $name, ".toml")))),*]
    };
}
pub(crate) use bundle;

/// The text of the bundled file `name`. `known` formats the list of names for the error.
pub(crate) fn bundled_text(
    what: &'static str,
    bundle: &[(&str, &'static str)],
    name: &str,
    known: impl FnOnce(String) -> String,
) -> Result<&'static str, ConfigFileError> {
    let found = bundle.iter().find(|(bundled, _)| *bundled == name);
    found.map(|(_, text)| *text).ok_or_else(|| {
        let names: Vec<&str> = bundle.iter().map(|(bundled, _)| *bundled).collect();
        ConfigFileError::UnknownName { what, name: name.to_owned(), known: known(names.join(", ")) }
    })
}

/// Counted from 1.
pub(crate) fn line_of(text: &str, offset: usize) -> usize {
    1 + text.bytes().take(offset).filter(|byte| *byte == b'\n').count()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The fields of numbers, one in a line as rustfmt writes them.
    fn numeric_keys(types: &str) -> impl Iterator<Item = &str> {
        const NUMBERS: [&str; 10] = ["f32", "f64", "u8", "u16", "u32", "u64", "usize", "i16", "i32", "i64"];
        let fields = types.lines().take_while(|line| *line != "#[cfg(test)]").filter_map(|line| {
            let field = line.trim().strip_suffix(',')?;
            field.strip_prefix("pub ").unwrap_or(field).split_once(": ")
        });
        fields.filter(|(_, kind)| NUMBERS.iter().any(|number| kind.contains(number))).map(|(key, _)| key)
    }

    #[test]
    fn each_range_is_that_of_a_key_and_of_no_other_range_and_each_key_has_one() {
        let files = [
            include_str!("scenario/mod.rs"),
            include_str!("scenario/pictures.rs"),
            include_str!("scenario/robot.rs"),
            include_str!("scenario/sensors.rs"),
            include_str!("montecarlo/disturbances.rs"),
            include_str!("montecarlo/limits.rs"),
            include_str!("montecarlo/observers.rs"),
            include_str!("montecarlo/scenario.rs"),
            include_str!("wall/scene.rs"),
            include_str!("impairment/profile.rs"),
        ];
        for (range, (low, high, keys)) in RANGES.iter().enumerate() {
            for key in keys.split_whitespace() {
                assert!(files.iter().any(|text| text.contains(&format!(" {key}: "))), "{key}");
                assert_eq!(range_of(key), (*low, *high), "{key} in range {range}");
            }
        }
        let ranged: Vec<&str> = RANGES.iter().flat_map(|(_, _, keys)| keys.split_whitespace()).collect();
        for key in files.into_iter().flat_map(numeric_keys) {
            assert!(ranged.contains(&key), "`{key}` is in no range: choose one");
        }
    }

    #[test]
    fn numbers_are_checked_in_nested_tables_and_arrays_up_to_the_ends_of_their_ranges() {
        for text in ["a = 0", "a = 1000000", "[b]\nc = [{ loss = 1.0 }, { loss = 0 }]", "x_m = -1e6", "seed = -1"] {
            assert_eq!(check_ranges(text), Ok(()), "{text}");
        }
        for text in ["a = -0.1", "a = 1000001", "[b]\nc = [{ loss = 1.01 }]", "x_m = -1e7", "a = nan", "[b]\na = [-1]"]
        {
            let error = check_ranges(text).unwrap_err().to_string();
            assert!(error.contains("give a number in that range") && error.contains("line"), "{text}: {error}");
        }
    }
}
