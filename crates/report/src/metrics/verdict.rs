//! Verdicts on a filter's claims: on each source by its innovations, on the whole by its errors where the truth is known.
//!
//! Both are the same function of a mean and its band ([`ConsistencyBand::classify`]). Where an ANEES is known it decides about the
//! whole, and the sources only explain: innovations cannot show an error that all sources share, and a source whose noise is set too
//! large does no harm to a pose that others determine.

use std::fmt::{self, Write as _};

use posebridge_telemetry::SensorId;

use super::consistency::{Consistency, ConsistencyBand};
use super::error::ErrorSummary;

/// Weaker correlations are significant in long recordings but irrelevant to a filter.
const MIN_CORRELATION: f64 = 0.1;
/// A larger share of gated observations indicates a problem of the sensor or of its noise; by chance it would be 0.1 %.
const MAX_GATED_SHARE: f64 = 0.05;
/// A source of which the gate refuses more contradicts the filter, whatever the innovations that were let through are like.
const MAX_CONTRADICTED_SHARE: f64 = 0.2;
/// A smaller share than this happens by chance.
const MIN_GATED_SHARE: f64 = 0.005;

/// Rating of a verdict for the reader.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum VerdictTone {
    Good,
    Inconclusive,
    Bad,
}

impl From<Consistency> for VerdictTone {
    fn from(finding: Consistency) -> Self {
        match finding {
            Consistency::OverConfident | Consistency::UnderConfident => Self::Bad,
            Consistency::TooLittleData => Self::Inconclusive,
            Consistency::Consistent => Self::Good,
        }
    }
}

/// What the innovations of one source say.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SourceVerdict {
    pub finding: Consistency,
    /// `None` without predictions.
    pub mean_nis_per_dof: Option<f64>,
    pub degrees_of_freedom: u64,
    /// 95 % interval of the mean for correct claims; `None` for too few innovations.
    pub band: Option<ConsistencyBand>,
    /// Of successive innovations.
    pub correlation: Option<f64>,
    /// 95 % bound of the correlation of white innovations.
    pub correlation_bound: Option<f64>,
    /// Rejected share of the observations that reached the gate.
    pub gated_share: Option<f64>,
}

impl SourceVerdict {
    /// Whether the correlation of successive innovations is significant and large enough to matter.
    pub fn has_correlation(&self) -> bool {
        let limit = self.correlation_bound.unwrap_or(1.0).max(MIN_CORRELATION);
        self.finding != Consistency::TooLittleData && self.correlation.is_some_and(|rho| rho.abs() > limit)
    }

    pub fn has_many_gated(&self) -> bool {
        self.gated_share.is_some_and(|share| share > MAX_GATED_SHARE)
    }

    fn contradicts_filter(&self) -> bool {
        let is_refused = self.gated_share.is_some_and(|share| share > MAX_CONTRADICTED_SHARE);
        self.finding == Consistency::OverConfident || is_refused && self.finding != Consistency::TooLittleData
    }

    pub fn tone(&self) -> VerdictTone {
        if self.has_correlation() || self.has_many_gated() {
            return VerdictTone::Bad;
        }
        self.finding.into()
    }
}

impl fmt::Display for SourceVerdict {
    /// In plain words, with a recommendation.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write_size(f, self)?;
        if let Some(rho) = self.correlation.filter(|_| self.has_correlation()) {
            let (how, cause) = if rho > 0.0 {
                ("alike", "something slow is missing from the model")
            } else {
                ("opposed", "the filter follows each observation too far, or two sources disagree")
            };
            let bound = self.correlation_bound.unwrap_or(0.0);
            write!(
                f,
                "; successive innovations are {how} (correlation {rho:.2}, by chance up to {bound:.2}): {cause}"
            )?;
        }
        if let Some(share) = self.gated_share.filter(|_| self.has_many_gated()) {
            write!(f, "; the gate turned {:.0} % away: outliers, or a noise that is set too small", share * 100.0)?;
        }
        Ok(())
    }
}

fn write_size(f: &mut fmt::Formatter<'_>, verdict: &SourceVerdict) -> fmt::Result {
    let word = verdict.finding;
    let (Some(mean), Some(band)) = (verdict.mean_nis_per_dof, verdict.band) else {
        return match verdict.degrees_of_freedom {
            0 => write!(f, "{word}: the filter predicts nothing of it"),
            some => write!(f, "{word}: {some} degrees of freedom"),
        };
    };
    write!(f, "{word}: NIS {mean:.2}, due {:.2} to {:.2}", band.low, band.high)?;
    let factor = mean.sqrt();
    match verdict.finding {
        Consistency::TooLittleData => Ok(()),
        Consistency::Consistent if (band.low..=band.high).contains(&mean) => Ok(()),
        Consistency::Consistent => {
            write!(f, "; its noise is right within {:.0} %", ((factor - 1.0).abs() * 100.0).ceil())
        }
        Consistency::OverConfident => write!(f, "; raise its noise {factor:.1} times"),
        Consistency::UnderConfident => write!(f, "; lower its noise to {factor:.2} of what it is"),
    }
}

/// What errors and innovations say of the whole filter.
#[derive(Clone, Debug, PartialEq)]
pub struct FilterVerdict {
    pub finding: Consistency,
    /// Average normalised estimation error squared over 3, and its 95 % interval for correct claims; `None` without truth.
    pub anees: Option<(f64, ConsistencyBand)>,
    /// Estimates whose covariance is impossible.
    pub refused_covariances: usize,
    pub sources: Vec<(SensorId, SourceVerdict)>,
}

impl FilterVerdict {
    /// `errors` are those against the truth, or empty, averaged over so many independent `runs`. A run counts as one sample: the
    /// errors at successive instants are not independent. A filter with a covariance that could not be tested is over-confident,
    /// because such a covariance is impossible.
    pub fn new(errors: &ErrorSummary, runs: u64, sources: Vec<(SensorId, SourceVerdict)>) -> Self {
        let anees = errors.anees.zip(ConsistencyBand::of_runs(runs));
        let finding = match anees {
            _ if errors.refused_covariances > 0 => Consistency::OverConfident,
            Some((value, band)) => band.classify(value),
            None => finding_of_sources(&sources),
        };
        Self { finding, anees, refused_covariances: errors.refused_covariances, sources }
    }

    /// Without truth no better than that of its worst source.
    pub fn tone(&self) -> VerdictTone {
        let is_any_bad = self.sources.iter().any(|(_, verdict)| verdict.tone() == VerdictTone::Bad);
        if self.anees.is_none() && is_any_bad { VerdictTone::Bad } else { self.finding.into() }
    }

    fn names(&self, finding: Consistency) -> String {
        let these = self.sources.iter().filter(|(_, verdict)| verdict.finding == finding);
        let named = these.map(|(sensor, verdict)| match verdict.mean_nis_per_dof {
            Some(mean) => format!("{} (NIS {mean:.2})", sensor.name()),
            None => sensor.name().to_owned(),
        });
        named.collect::<Vec<_>>().join(", ")
    }

    /// The source of which the gate refused most, and that share; `None` if it refused nothing that counts.
    fn most_gated(&self) -> Option<(&'static str, f64)> {
        let shares = self.sources.iter().filter_map(|(sensor, verdict)| Some((sensor.name(), verdict.gated_share?)));
        shares.filter(|(_, share)| *share >= MIN_GATED_SHARE).max_by(|one, other| one.1.total_cmp(&other.1))
    }

    /// Why the innovations of sources disagree with the finding; empty where they do not.
    fn disagreement(&self) -> String {
        let mut text = String::new();
        let (over, under) = (self.names(Consistency::OverConfident), self.names(Consistency::UnderConfident));
        // Writing to a String cannot fail.
        match self.finding {
            // Without truth it is the sources that decide, and what their mean does not show.
            _ if self.anees.is_none() => {
                for (sensor, verdict) in &self.sources {
                    if let Some(share) = verdict.gated_share.filter(|_| verdict.has_many_gated()) {
                        let _ = write!(text, "; the gate refused {:.0} % of {}", share * 100.0, sensor.name());
                    }
                    if verdict.has_correlation() {
                        let _ = write!(text, "; successive innovations of {} are correlated", sensor.name());
                    }
                }
            }
            Consistency::Consistent => {
                if !over.is_empty() {
                    let _ = write!(text, "; too little noise is set for {over}, and the other sources make up for it");
                }
                if !under.is_empty() {
                    let _ = write!(text, "; more noise is set than {under} has, and the pose does not suffer by it");
                }
            }
            Consistency::OverConfident if !over.is_empty() => {
                let _ = write!(text, "; {over} shows it, too");
            }
            Consistency::OverConfident => match self.most_gated() {
                Some((name, share)) => {
                    let share = share * 100.0;
                    let _ = write!(
                        text,
                        "; the gate refused {share:.1} % of {name}: the robot was moved, or it has outliers"
                    );
                }
                None => {
                    text += "; no innovation shows it: the sources share an error, such as a frame, a delay or a camera that is off";
                }
            },
            Consistency::UnderConfident if !over.is_empty() => {
                let _ = write!(text, "; too little noise is set for {over} all the same");
            }
            Consistency::UnderConfident | Consistency::TooLittleData => {}
        }
        text
    }
}

/// A source that contradicts the filter outweighs one with too much noise, and both a consistent one.
fn finding_of_sources(sources: &[(SensorId, SourceVerdict)]) -> Consistency {
    if sources.iter().any(|(_, verdict)| verdict.contradicts_filter()) {
        return Consistency::OverConfident;
    }
    let is_any = |finding| sources.iter().any(|(_, verdict)| verdict.finding == finding);
    let by_weight = [Consistency::UnderConfident, Consistency::Consistent];
    by_weight.into_iter().find(|finding| is_any(*finding)).unwrap_or(Consistency::TooLittleData)
}

impl fmt::Display for FilterVerdict {
    /// One line: the finding, its figure and band, and what disagrees with it.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: ", self.finding)?;
        if self.refused_covariances > 0 {
            return write!(f, "{} covariances are not positive definite", self.refused_covariances);
        }
        match &self.anees {
            Some((value, band)) => write!(f, "ANEES {value:.2}, due {:.2} to {:.2}", band.low, band.high)?,
            None if self.finding == Consistency::TooLittleData => {
                return write!(f, "no truth, and no source was predicted often enough");
            }
            None => {
                let names = self.names(self.finding);
                if names.is_empty() {
                    // Only the gate contradicts.
                    return f.write_str(self.disagreement().trim_start_matches("; "));
                }
                write!(f, "by the innovations of {names}")?;
            }
        }
        write!(f, "{}", self.disagreement())
    }
}
