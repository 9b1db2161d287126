//! Every tunable of the filters, declared once: the keys of `[filter]`, their range checks and the schema follow from
//! [`PARAMS`]. Geometry and sensor noise belong to a robot, not to a filter.

use std::ops::RangeInclusive;

/// The tunables of the filters, SI units; [`PARAMS`] describes each.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Params {
    pub gate_probability: f64,
    pub history_s: f64,
    pub gyro_window_s: f64,
    pub slip_nis: f64,
    pub acceleration_m_per_s2: f64,
    pub turn_acceleration_rad_per_s2: f64,
    pub max_wheel_rad_per_s: f64,
    pub fix_timeout_s: f64,
    pub reset_after_s: f64,
    pub reset_after_fixes: f64,
    pub adapt_gain: f64,
    pub student_dof: f64,
    pub wear_per_sqrt_m: f64,
    pub dynamic_tau_s: f64,
    pub dynamic_walk_k_per_sqrt_s: f64,
    pub wall_drag_s_per_m: f64,
    pub wall_mass_s2_per_m: f64,
    pub wall_process_m: f64,
    pub wall_gate_m: f64,
}

pub struct Param {
    /// Its key in the configuration, below `[filter]`; at most 16 bytes, so that it fits PARAM messages.
    pub key: &'static str,
    /// Empty for a pure number.
    pub unit: &'static str,
    pub default: f64,
    /// Permitted values.
    pub range: RangeInclusive<f64>,
    /// Its effect, in one line.
    pub doc: &'static str,
    pub read: fn(&Params) -> f64,
    pub write: fn(&mut Params, f64),
}

/// A row: field, key, unit, default, range, what it does.
macro_rules! param {
    ($field:ident: $key:literal [$unit:literal], $default:literal in $range:expr; $doc:literal) => {
        Param {
            key: $key,
            unit: $unit,
            default: $default,
            range: $range,
            doc: $doc,
            read: |params| params.$field,
            write: |params, value| params.$field = value,
        }
    };
}

/// Every tunable. Adding one: a field of [`Params`] and a row here.
pub const PARAMS: &[Param] = &[
    // 99.9 %: with a well-chosen R one good fix in a thousand is lost, and half-metre outliers do no harm.
    param!(gate_probability: "gate_prob" [""], 0.999 in 0.5..=0.999_999;
        "a fix is used if its normalised innovation is below this quantile of chi-square"),
    param!(history_s: "history_s" ["s"], 3.0 in 0.1..=60.0;
        "how late an observation may come and still be applied at its own time"),
    // 0.2 s: four readings of a 20 Hz brick average the gyro, and a window rarely holds rest and motion at once.
    param!(gyro_window_s: "gyro_window_s" ["s"], 0.2 in 0.0..=5.0;
        "length of the window in which the gyro is held against the encoders' heading"),
    // Chi-square with one degree of freedom, 99.9 %.
    param!(slip_nis: "slip_nis" [""], 10.83 in 4.0..=100.0;
        "above this normalised innovation gyro and encoders disagree: the wheels slipped"),
    // A LEGO motor reaches 0.5 m/s in about 0.1 s at full voltage; a robot under control stays well below that.
    param!(acceleration_m_per_s2: "accel_m_s2" ["m/s2"], 1.0 in 0.01..=50.0;
        "how fast the forward speed may change, one standard deviation after one second"),
    param!(turn_acceleration_rad_per_s2: "turn_acc_rad_s2" ["rad/s2"], 6.0 in 0.01..=500.0;
        "how fast the turn rate may change, one standard deviation after one second"),
    // A LEGO motor turns 18 rad/s unloaded at 9 V; fast hobby motors about five times that.
    param!(max_wheel_rad_per_s: "max_wheel_rad_s" ["rad/s"], 100.0 in 1.0..=1_000.0;
        "a wheel cannot turn faster: a larger jump of the counters re-bases them"),
    param!(fix_timeout_s: "fix_timeout_s" ["s"], 2.0 in 0.1..=600.0;
        "without a fix for longer than this the estimate is flagged as dead reckoning"),
    param!(reset_after_s: "reset_after_s" ["s"], 5.0 in 0.1..=600.0;
        "fixes that agree with each other but not with the estimate for this long move the estimate"),
    param!(reset_after_fixes: "reset_after_n" [""], 3.0 in 2.0..=1_000.0;
        "and at least this many of them"),
    // 3 %: about fifty observations are remembered, so that the scale follows a camera that is moved within seconds.
    param!(adapt_gain: "adapt_gain" [""], 0.03 in 0.0..=0.5;
        "how fast the noise of a source follows its innovations; 0 takes it as configured"),
    param!(student_dof: "student_dof" [""], 0.0 in 0.0..=100.0;
        "degrees of freedom of Student's t for absolute observations, instead of the gate; 0 for Gaussian with gate"),
    // A tyre that loses a tenth of a per cent over a kilometre.
    param!(wear_per_sqrt_m: "wear_per_sqrt_m" [""], 0.000_03 in 0.0..=0.1;
        "how fast wheel radii and track may change: sigma after one metre, while fixes tell of it"),
    // 148 s: a LEGO thermometer whose readings 21, 15, 11 degrees come a minute apart (paper 2), 60 s / ln 1.5.
    param!(dynamic_tau_s: "dynamic_tau_s" ["s"], 148.0 in 0.001..=100_000.0;
        "time constant of the thermometer, for the prediction of its final value"),
    // Paper 2 measures a constant.
    param!(dynamic_walk_k_per_sqrt_s: "dynamic_walk" ["K/s^0.5"], 0.0 in 0.0..=1_000.0;
        "random walk of the measured temperature itself; 0 for a constant"),
    // Paper 3: 1 / (1225 mm/s), the speed of its step test.
    param!(wall_drag_s_per_m: "wall_drag_s_m" ["s/m"], 0.816_33 in 0.001..=1_000.0;
        "drag of the robot that approaches a wall: motor input per steady speed"),
    // Paper 3: drag x 0.997 s / ln 10.
    param!(wall_mass_s2_per_m: "wall_mass_s2_m" ["s2/m"], 0.353_46 in 0.000_1..=1_000.0;
        "mass of the robot that approaches a wall: motor input per acceleration"),
    // Paper 3: Sigma_u = diag(50^2, 50^2), in mm and mm/s, per step of its loop.
    param!(wall_process_m: "wall_process_m" ["m, m/s"], 0.05 in 0.000_01..=10.0;
        "process noise of distance and speed before a wall, one standard deviation per step of 7.6 ms"),
    // Paper 3 names GATE_MIN and gives no number. Below this no reading of its sensor is worth refusing.
    param!(wall_gate_m: "wall_gate_m" ["m"], 0.1 in 0.0..=100.0;
        "a range is never refused for an innovation smaller than this"),
];

impl Default for Params {
    fn default() -> Self {
        let mut params = Self {
            gate_probability: 0.0,
            history_s: 0.0,
            gyro_window_s: 0.0,
            slip_nis: 0.0,
            acceleration_m_per_s2: 0.0,
            turn_acceleration_rad_per_s2: 0.0,
            max_wheel_rad_per_s: 0.0,
            fix_timeout_s: 0.0,
            reset_after_s: 0.0,
            reset_after_fixes: 0.0,
            adapt_gain: 0.0,
            student_dof: 0.0,
            wear_per_sqrt_m: 0.0,
            dynamic_tau_s: 0.0,
            dynamic_walk_k_per_sqrt_s: 0.0,
            wall_drag_s_per_m: 0.0,
            wall_mass_s2_per_m: 0.0,
            wall_process_m: 0.0,
            wall_gate_m: 0.0,
        };
        for row in PARAMS {
            (row.write)(&mut params, row.default);
        }
        params
    }
}

impl Params {
    /// Errors: the key is unknown, or the value is outside the row's range.
    pub fn set(&mut self, key: &str, value: f64) -> Result<(), ParamError> {
        let row =
            PARAMS.iter().find(|row| row.key == key).ok_or_else(|| ParamError::Unknown { key: key.to_owned() })?;
        if !row.range.contains(&value) {
            return Err(ParamError::OutOfRange {
                key: row.key,
                value,
                low: *row.range.start(),
                high: *row.range.end(),
            });
        }
        (row.write)(self, value);
        Ok(())
    }
}

#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ParamError {
    #[error("unknown filter parameter `{key}`")]
    Unknown { key: String },
    #[error("filter parameter `{key}` is {value}, must lie in {low} to {high}")]
    OutOfRange { key: &'static str, value: f64, low: f64, high: f64 },
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_row_sets_a_field_of_its_own_and_its_default_is_in_range() {
        for (index, row) in PARAMS.iter().enumerate() {
            assert!(row.range.contains(&row.default), "{}", row.key);
            assert!(row.key.len() <= 16, "{} does not fit a PARAM message", row.key);
            let mut params = Params::default();
            assert_eq!(row.key, row.key.to_ascii_lowercase(), "a PARAM message tells it in capitals");
            (row.write)(&mut params, -1.0);
            for (other_index, other) in PARAMS.iter().enumerate() {
                let expected = if index == other_index { -1.0 } else { other.default };
                assert_eq!((other.read)(&params), expected, "{} against {}", row.key, other.key);
            }
        }
    }

    #[test]
    fn a_value_out_of_range_is_refused_with_its_range() {
        let error = Params::default().set("slip_nis", 1.0).unwrap_err();
        assert_eq!(error.to_string(), "filter parameter `slip_nis` is 1, must lie in 4 to 100");
    }
}
