//! What is known of a slow sensor before it is read: its lags as distributions over the sensors of its kind, its noise, its
//! resolution.

/// A positive quantity whose logarithm is normally distributed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LogNormal {
    pub median: f64,
    /// One standard deviation of the natural logarithm: about the relative error.
    pub ln_sigma: f64,
}

/// The slower time constant of a sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SlowLag {
    /// Every time constant from 0.5 s to 1,200 s, each decade as likely as the next.
    Unknown,
    /// In seconds.
    Known(LogNormal),
}

/// Lags closer than this cannot be told apart.
pub const MIN_LAG_RATIO: f64 = 1.3;

/// How a sensor follows its quantity: a step leaves (1 - s) e^(-t / tau) + s e^(-t ratio / tau) of itself.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorDynamics {
    /// tau.
    pub slow_lag: SlowLag,
    /// tau over the faster time constant; at least [`MIN_LAG_RATIO`].
    pub lag_ratio: LogNormal,
    /// s: how much of a step follows the faster lag, with one standard deviation.
    pub fast_share: f64,
    pub fast_share_sigma: f64,
    /// Prior probability that there is no faster lag, less than 1.
    pub single_lag_probability: f64,
}

impl SensorDynamics {
    /// Of any sensor.
    pub const UNKNOWN: Self = Self {
        slow_lag: SlowLag::Unknown,
        lag_ratio: LogNormal { median: 5.0, ln_sigma: 0.8 },
        fast_share: 0.4,
        fast_share_sigma: 0.25,
        // A single lag explains the beginning of two too well: with more than this, bounds are too narrow until the slower one shows.
        single_lag_probability: 0.05,
    };
}

/// The response, noise and resolution of a slow sensor, in its own unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SlowSensor {
    pub dynamics: SensorDynamics,
    /// Noise of a reading, one standard deviation; zero if unknown.
    pub noise: f64,
    /// The step between two values that it can show; zero if fine. It counts as noise of a step over the root of twelve.
    pub resolution: f64,
}

impl SlowSensor {
    /// A sensor of which nothing is known.
    pub const UNKNOWN: Self = Self { dynamics: SensorDynamics::UNKNOWN, noise: 0.0, resolution: 0.0 };
}
