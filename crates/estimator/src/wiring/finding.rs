//! What was found, with its evidence, in words.

use std::fmt;

use serde::{Deserialize, Serialize};

use super::fault::WiringFault;

/// Two sensors that observe the same motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum RatioKind {
    /// The gyro's turn over that of the wheels.
    GyroTurn,
    /// The turn between fixes over that of the wheels.
    FixTurn,
    /// The distance between fixes over that of the wheels.
    FixDistance,
}

impl RatioKind {
    pub(super) const ALL: [Self; 3] = [Self::GyroTurn, Self::FixTurn, Self::FixDistance];
}

/// What one sensor observed over what the wheels reported, in the windows that show a fault. For one reversed wheel, the
/// report without the fault.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct WiringRatio {
    pub kind: RatioKind,
    pub value: f64,
    /// One standard deviation.
    pub sigma: f64,
}

/// What is missing to decide between several faults.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum DecidingObservation {
    Fixes,
    FixesWithHeading,
    Gyro,
}

/// One fault, or several that look the same so far.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct WiringFinding {
    /// In the order of [`WiringFault::ALL`]; one if it is decided.
    pub candidates: Vec<WiringFault>,
    pub ratio: WiringRatio,
    /// `None` if it is decided.
    pub missing: Option<DecidingObservation>,
}

impl WiringFinding {
    /// The fault, if it is decided.
    pub fn fault(&self) -> Option<WiringFault> {
        if let [fault] = self.candidates.as_slice() { Some(*fault) } else { None }
    }
}

/// One line of text.
impl fmt::Display for WiringFinding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let WiringRatio { kind, value, sigma } = self.ratio;
        let observer = match kind {
            RatioKind::GyroTurn => "the gyro turns",
            RatioKind::FixTurn => "the camera sees the robot turn",
            RatioKind::FixDistance => "the camera sees",
        };
        let times = Times { value: value.abs(), sigma };
        match (kind, self.fault()) {
            (_, Some(WiringFault::LeftWheelReversed)) => {
                write!(f, "{observer} {times} times as far as the wheels with the left one reversed: ")?;
            }
            (_, Some(WiringFault::RightWheelReversed)) => {
                write!(f, "{observer} {times} times as far as the wheels with the right one reversed: ")?;
            }
            (RatioKind::FixDistance, _) => write!(f, "{observer} {times} times the distance of the wheels: ")?,
            (RatioKind::GyroTurn | RatioKind::FixTurn, _) if value < 0.0 => {
                write!(f, "{observer} the other way than the wheels ({times} times as far): ")?;
            }
            (RatioKind::GyroTurn | RatioKind::FixTurn, _) => {
                write!(f, "{observer} {times} times as far as the wheels: ")?;
            }
        }
        for (index, fault) in self.candidates.iter().enumerate() {
            let joint = match index {
                0 if self.candidates.len() > 1 => "either ",
                0 => "",
                _ => ", or ",
            };
            write!(f, "{joint}{}", fault.conclusion())?;
        }
        match self.missing {
            None => Ok(()),
            Some(DecidingObservation::Fixes) => f.write_str("; fixes of a camera would decide"),
            Some(DecidingObservation::FixesWithHeading) => f.write_str("; fixes with a heading would decide"),
            Some(DecidingObservation::Gyro) => f.write_str("; a gyro would decide"),
        }
    }
}

/// A ratio with as many digits as its uncertainty leaves.
struct Times {
    value: f64,
    sigma: f64,
}

impl fmt::Display for Times {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let decimals = (1.0 - self.sigma.max(1e-6).log10().floor()).clamp(0.0, 5.0) as usize;
        write!(f, "{:.decimals$} ± {:.decimals$}", self.value, self.sigma)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn finding(candidates: &[WiringFault], kind: RatioKind, value: f64) -> String {
        let missing = (candidates.len() > 1).then_some(DecidingObservation::Fixes);
        let ratio = WiringRatio { kind, value, sigma: 0.21 };
        WiringFinding { candidates: candidates.to_vec(), ratio, missing }.to_string()
    }

    #[test]
    fn a_finding_is_one_sentence_with_its_ratio() {
        assert_eq!(
            finding(&[WiringFault::GyroInDegrees], RatioKind::GyroTurn, 57.3),
            "the gyro turns 57.30 ± 0.21 times as far as the wheels: the gyro reports degrees per second"
        );
        assert_eq!(
            finding(&[WiringFault::WheelsSwapped, WiringFault::GyroReversed], RatioKind::GyroTurn, -1.0),
            "the gyro turns the other way than the wheels (1.00 ± 0.21 times as far): either the left and the right wheel are \
             swapped, or the gyro's axis is reversed; fixes of a camera would decide"
        );
        assert_eq!(
            finding(&[WiringFault::LeftWheelReversed], RatioKind::FixDistance, 1.0),
            "the camera sees 1.00 ± 0.21 times as far as the wheels with the left one reversed: the left wheel counts backwards"
        );
    }
}
