//! Why a log gives no drive, or a part of it.

use posebridge_telemetry::UncertainValue;

#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum WallStepError {
    #[error("{found} readings since the drive began, {needed} are needed; drive longer or read faster")]
    TooFewReadings { found: usize, needed: usize },
    #[error("the log holds no motor input, so the start of the step is unknown")]
    NoInput,
    #[error("the readings do not show a car that speeds up towards the wall")]
    NoMotion,
    #[error(
        "the distance changes by {:.0} mm where a reading has {:.0} mm of noise: no step is to be seen; did the motors run?",
        1e3 * way_m, 1e3 * noise_m
    )]
    Stands { way_m: f64, noise_m: f64 },
    #[error(
        "the distance only grows, by {away_m:.2} m: the car drives away from the wall; turn it or the sensor round"
    )]
    MovesAway { away_m: f64 },
    #[error("{0}")]
    Undetermined(UndeterminedReason),
}

/// What a step cannot tell, and why.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum UndeterminedReason {
    #[error(
        "the readings do not show that the car reached a steady speed, {last_m_per_s:.2} m/s at the end: v_ss, d and t90 would be \
         guesses ({guess}); give it a longer way or less PWM"
    )]
    NoSteadySpeed { last_m_per_s: f64, guess: Guess },
    #[error(
        "the car reached its speed too fast for readings {period_s:.3} s apart: its rise would be a guess ({guess}); \
         read faster, or take a heavier car"
    )]
    RisesBetweenReadings { period_s: f64, guess: Guess },
    #[error(
        "the log begins when the car has its speed: its rise would be a guess ({guess}); start recording before the motors"
    )]
    BeginsOnTheWay { guess: Guess },
    #[error("readings with {:.0} mm of noise leave {guess}; drive several steps, or at a better target", 1e3 * noise_m)]
    TooNoisy { noise_m: f64, guess: Guess },
}

/// A value and its sigma, too uncertain to be reported as known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Guess {
    pub name: &'static str,
    pub value: UncertainValue,
}

impl std::fmt::Display for Guess {
    fn fmt(&self, to: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(to, "{} {:.2} ± {:.2}", self.name, self.value.value, self.value.sigma)
    }
}
