//! The cameras with clocks of their own that see one robot: which of them may correct its pose.
//!
//! Anybody who reaches an open port can pretend to be a camera. While a camera that the filter agrees with sees the robot, another one is
//! used only after some of its fixes in a row were near the estimate. So is a camera that announces a jump of its own (a lone camera may jump,
//! one of several is wrong then), and one whose fixes were far from the estimate. Without another camera the first fix counts, as it must. A stranger who follows the estimate for a
//! while can still mislead a robot; `pin` and signing are against that (docs/routing.md).

use posebridge_estimator::RestoreError;
use posebridge_telemetry::{Address, Estimate, Fix, HostClock, SensorId, TimeDelta, Timestamp};
use serde::{Deserialize, Serialize};

use crate::fix_requests::MAX_CAMERAS;
use crate::host_times::ShiftHostTimes;
use crate::observers::ObserverId;

/// A camera sees the robot for so long after the last fix that the filter accepted.
const WATCH_TIMEOUT: TimeDelta = TimeDelta::from_millis(2_000);
/// Fixes in a row near the estimate after which a newcomer is used.
const AGREEMENTS: u32 = 5;
/// How far a fix that agrees may be from the estimate beside their sigmas: cameras are off by some centimetres from each other.
const MAX_DISAGREEMENT_M: f64 = 0.3;
const MAX_DISAGREEMENT_SIGMAS: f64 = 5.0;
const MAX_HEADING_DISAGREEMENT_RAD: f64 = 0.5;
/// A camera that calls itself less certain than this agrees with nothing better.
const MAX_FIX_SIGMA_M: f64 = 0.2;
/// Disagreeing fixes in a row after which a camera has to agree again; fewer are outliers, which the filter's gate refuses.
const DISAGREEMENTS: u32 = 3;
/// After so many it is named.
const DISAGREEMENTS_TO_NAME: u32 = 5;

/// What becomes of a camera's fix.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum FixAdmission {
    /// The filter is given it, with this reset counter.
    Use { sensor: SensorId, reset_counter: u8 },
    HoldBack {
        sensor: SensorId,
        /// Set when the camera is to be named: how far its fixes are from the estimate, in metres.
        named_distance_m: Option<f64>,
    },
}

/// What becomes of a camera that was never used, once another one was.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Newcomers {
    /// It may agree while another one sees the robot, and else is used at once.
    OnProbation,
    /// It is never used: on a link with `pin`.
    Refused,
}

/// A camera for a robot's table: as this station numbers it, and by its address, which other stations see as well.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct CameraIdentity {
    pub(crate) observer: ObserverId,
    pub(crate) address: Address,
}

#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct CameraTable {
    /// Each is a sensor of its own, by its index. One that was never used makes room for another.
    cameras: Vec<Camera>,
    /// When the filter last accepted a fix that the robot itself relayed.
    own_accepted: Option<Timestamp<HostClock>>,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
struct Camera {
    /// `None` for one that another station has seen, until this one does.
    #[serde(skip)]
    id: Option<ObserverId>,
    address: Address,
    first_seen: Timestamp<HostClock>,
    /// The filter was given one of its fixes.
    is_used: bool,
    /// When the filter last accepted one of its fixes.
    accepted: Option<Timestamp<HostClock>>,
    /// Its own counter, and the one that the filter has seen.
    counter: u8,
    given_counter: u8,
    /// Whether it has to agree with the estimate before it is used again.
    is_on_probation: bool,
    /// In a row.
    agreements: u32,
    disagreements: u32,
}

impl Camera {
    const fn new(id: CameraIdentity, counter: u8, now: Timestamp<HostClock>) -> Self {
        Self {
            id: Some(id.observer),
            address: id.address,
            first_seen: now,
            is_used: false,
            accepted: None,
            counter,
            given_counter: counter,
            is_on_probation: false,
            agreements: 0,
            disagreements: 0,
        }
    }

    fn is(&self, id: CameraIdentity) -> bool {
        self.id.map_or(self.address == id.address, |own| own == id.observer)
    }

    fn watches(&self, now: Timestamp<HostClock>) -> bool {
        !self.is_on_probation && self.accepted.is_some_and(|accepted| now - accepted <= WATCH_TIMEOUT)
    }

    /// Compares a fix with the estimate while another camera sees the robot. Returns the distance when the camera is to be named.
    fn judge(&mut self, fix: &Fix, estimate: &Estimate) -> Option<f64> {
        let distance_m = estimate.pose.origin().distance(fix.position).0;
        if agrees(fix, estimate, distance_m) {
            self.agreements = self.agreements.saturating_add(1);
            self.disagreements = 0;
            self.is_on_probation &= self.agreements < AGREEMENTS;
            return None;
        }
        self.agreements = 0;
        self.disagreements = self.disagreements.saturating_add(1);
        self.is_on_probation |= self.disagreements >= DISAGREEMENTS;
        (self.disagreements == DISAGREEMENTS_TO_NAME).then_some(distance_m)
    }
}

impl ShiftHostTimes for CameraTable {
    fn shift_host_times(&mut self, by: TimeDelta) {
        let Self { cameras, own_accepted } = self;
        own_accepted.shift_host_times(by);
        for camera in cameras {
            camera.first_seen.shift_host_times(by);
            camera.accepted.shift_host_times(by);
        }
    }
}

impl CameraTable {
    pub(crate) fn check(&self) -> Result<(), RestoreError> {
        (self.cameras.len() <= MAX_CAMERAS).then_some(()).ok_or(RestoreError::Implausible("it has too many cameras"))
    }

    /// Decides about a fix that arrives at `now`; `estimate` is that of its instant.
    pub(crate) fn admit(
        &mut self,
        now: Timestamp<HostClock>,
        id: CameraIdentity,
        fix: &Fix,
        newcomers: Newcomers,
        estimate: impl FnOnce() -> Option<Estimate>,
    ) -> FixAdmission {
        self.recognize(id);
        let is_watched = self.is_watched_by_other(now, id);
        let has_other = self.cameras.iter().any(|camera| !camera.is(id) && camera.is_used);
        let index = self.find_or_add(now, id, fix.reset_counter);
        let (camera, sensor) = (&mut self.cameras[index], SensorId::camera(index));
        if has_other && !camera.is_used && newcomers == Newcomers::Refused {
            camera.disagreements = camera.disagreements.saturating_add(1);
            let is_named = camera.disagreements == DISAGREEMENTS_TO_NAME;
            let named_distance_m =
                estimate().filter(|_| is_named).map(|estimate| estimate.pose.origin().distance(fix.position).0);
            return FixAdmission::HoldBack { sensor, named_distance_m };
        }
        let has_jumped = camera.counter != fix.reset_counter;
        camera.counter = fix.reset_counter;
        if !is_watched {
            camera.is_on_probation = false;
            if has_jumped {
                camera.given_counter = camera.given_counter.wrapping_add(1);
            }
        } else if has_jumped || !camera.is_used {
            camera.agreements *= u32::from(!has_jumped);
            camera.is_on_probation = true;
        }
        let estimate = if is_watched { estimate() } else { None };
        let named_distance_m = estimate.and_then(|estimate| camera.judge(fix, &estimate));
        if camera.is_on_probation {
            return FixAdmission::HoldBack { sensor, named_distance_m };
        }
        camera.is_used = true;
        FixAdmission::Use { sensor, reset_counter: camera.given_counter }
    }

    /// Whether the filter accepted a fix of a camera lately.
    pub(crate) fn is_seen_by(&self, now: Timestamp<HostClock>, id: CameraIdentity) -> bool {
        self.cameras.iter().any(|camera| camera.is(id) && camera.watches(now))
    }

    /// Notes that the filter accepted a fix of a camera, or `None` of the robot's own.
    pub(crate) fn record_accepted(&mut self, now: Timestamp<HostClock>, id: Option<CameraIdentity>) {
        let Some(id) = id else {
            self.own_accepted = Some(now);
            return;
        };
        if let Some(camera) = self.cameras.iter_mut().find(|camera| camera.is(id)) {
            camera.accepted = Some(now);
        }
    }

    fn is_watched_by_other(&self, now: Timestamp<HostClock>, id: CameraIdentity) -> bool {
        let is_own = self.own_accepted.is_some_and(|accepted| now - accepted <= WATCH_TIMEOUT);
        is_own || self.cameras.iter().any(|camera| !camera.is(id) && camera.watches(now))
    }

    /// Gives a camera that another station has seen the number that it has here.
    fn recognize(&mut self, id: CameraIdentity) {
        if self.cameras.iter().any(|camera| camera.id == Some(id.observer)) {
            return;
        }
        if let Some(camera) = self.cameras.iter_mut().find(|camera| camera.id.is_none() && camera.is(id)) {
            camera.id = Some(id.observer);
        }
    }

    /// The index of a camera. Beyond the limit a new one takes the place of the oldest that was never used, else of the last.
    fn find_or_add(&mut self, now: Timestamp<HostClock>, id: CameraIdentity, counter: u8) -> usize {
        if let Some(index) = self.cameras.iter().position(|camera| camera.is(id)) {
            return index;
        }
        let camera = Camera::new(id, counter, now);
        if self.cameras.len() < MAX_CAMERAS {
            self.cameras.push(camera);
            return self.cameras.len() - 1;
        }
        let unused = (0..MAX_CAMERAS).filter(|index| !self.cameras[*index].is_used);
        let index = unused.min_by_key(|index| self.cameras[*index].first_seen).unwrap_or(MAX_CAMERAS - 1);
        self.cameras[index] = camera;
        index
    }
}

fn agrees(fix: &Fix, estimate: &Estimate, distance_m: f64) -> bool {
    let [x_m, y_m] = [estimate.x_sigma_m(), estimate.y_sigma_m()];
    let fix_m2 =
        fix.covariance.map_or(0.0, |covariance| covariance.xx_m2 + covariance.yy_m2).min(MAX_FIX_SIGMA_M.powi(2));
    let sigma_m = (x_m * x_m + y_m * y_m + fix_m2).sqrt();
    let lever_m = fix.tag_in_body.x.0.hypot(fix.tag_in_body.y.0);
    let is_near = distance_m <= MAX_DISAGREEMENT_M + lever_m + MAX_DISAGREEMENT_SIGMAS * sigma_m;
    let is_aligned = fix.heading.is_none_or(|heading| {
        let off_rad = (heading - estimate.pose.heading).0.abs();
        off_rad <= MAX_HEADING_DISAGREEMENT_RAD + MAX_DISAGREEMENT_SIGMAS * estimate.heading_sigma_rad()
    });
    is_near && is_aligned
}
