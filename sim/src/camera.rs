//! The overhead camera: measures the pose of the tag on the robot and sends it after a latency, with timestamps of its own clock.
//!
//! It streams fixes, or sends one per request, or sends none and outputs images (the corners of the tag, in pixels) to another program
//! that computes the fixes. It shares the link with the brick but is a component of its own. The log of sent fixes with their true values
//! is for tests and scores.
//!
//! ```text
//! u = 320 + x / 0.004      v = 240 - y / 0.004      pixels; 4 mm each, image y down; from straight above, without distortion
//! corners: of a square of 0.1 m about the tag, left rear, right rear, right front, left front, as of OpenCV's ArUco and AprilTag
//! ```

use std::collections::VecDeque;

use posebridge_protocol::dialect::ids;
use posebridge_protocol::message::{Heartbeat, Message, VisionFix, WireStamp};
use posebridge_telemetry::{
    Address, Arena, Body, CameraClock, Heading, Meters, Point2, Pose, Radians, TimeDelta, Timestamp,
};

use crate::clock::SkewedClock;
use crate::history::{HistoryPolicy, trim_history};
use crate::mavlink_node::{IntervalRequest, MavlinkNode};
use crate::random::RandomStream;
use crate::scenario::{CameraImages, CameraOrder, CameraSettings};

/// The camera's address on the link, unless its scenario gives the brick another system: MAV_COMP_ID_CAMERA (minimal.xml).
pub const CAMERA: Address = Address::new(1, 100);

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraFix {
    pub exposed: TimeDelta,
    pub sent: TimeDelta,
    pub time: Timestamp<CameraClock>,
    pub position: Point2<Arena>,
    /// Measured heading of the body; `None` when the camera does not measure it.
    pub heading: Option<Heading>,
    /// True position of the tag, true heading of the body.
    pub true_tag: Pose<Arena>,
    pub is_outlier: bool,
}

#[derive(Debug)]
pub(crate) struct Camera {
    pub(crate) settings: CameraSettings,
    clock: SkewedClock,
    node: MavlinkNode<CameraClock>,
    stream: RandomStream,
    patches: CalibrationPatches,
    /// Time between images; `None` while a station has stopped them.
    interval: Option<TimeDelta>,
    next_exposure: TimeDelta,
    /// Taken but not sent, in the order of sending.
    pending: Vec<CameraFix>,
    last_due: TimeDelta,
    pub(crate) history: HistoryPolicy,
    pub(crate) log: Vec<CameraFix>,
    /// Unread images; `Some` once a reader is connected, and then no fix is sent.
    pub(crate) images: Option<VecDeque<String>>,
    image_count: u64,
    /// The lens is covered: no fixes.
    pub(crate) is_covered: bool,
}

/// Older unread images are dropped.
const MAX_IMAGES: usize = 64;

impl Camera {
    pub(crate) fn new(settings: CameraSettings, own: Address, seed: u64) -> Self {
        let clock = SkewedClock::new(settings.clock_start_micros, settings.clock_skew_ppm, 1);
        let node =
            MavlinkNode::new(own, Heartbeat::CAMERA, clock.reading(TimeDelta::ZERO), &[ids::VISION_POSITION_ESTIMATE]);
        Self {
            interval: match settings.images {
                CameraImages::Steady => Some(TimeDelta::from_secs_f64(1.0 / settings.rate_hz)),
                CameraImages::OnRequest => None,
            },
            next_exposure: TimeDelta::ZERO,
            patches: CalibrationPatches { seed, sigma_m: settings.patch_sigma_m, size_m: settings.patch_size_m },
            settings,
            clock,
            node,
            stream: RandomStream::new(seed, "camera"),
            pending: Vec::new(),
            last_due: TimeDelta::ZERO,
            history: HistoryPolicy::All,
            log: Vec::new(),
            images: None,
            image_count: 0,
            is_covered: false,
        }
    }

    /// Advances by one step of the world that ends at `world` with the robot at `pose`.
    pub(crate) fn step(&mut self, world: TimeDelta, pose: Pose<Arena>) {
        let was_requested = std::mem::take(&mut self.node.is_fix_requested);
        if let Some(interval) = self.interval.filter(|_| world >= self.next_exposure) {
            self.next_exposure = (self.next_exposure + interval).max(world);
            self.expose(world, pose);
        } else if was_requested {
            self.expose(world, pose);
        }
        let due = self.pending.partition_point(|fix| fix.sent <= world);
        for fix in self.pending.drain(..due).collect::<Vec<_>>() {
            let message = self.message(&fix);
            self.node.send(&message);
            if self.history != HistoryPolicy::Nothing {
                trim_history(self.history, world, &mut self.log, |fix| fix.sent);
                self.log.push(fix);
            }
        }
        let requests = self.node.tick(self.clock.reading(world));
        self.apply_intervals(world, &requests);
    }

    pub(crate) fn handle(&mut self, world: TimeDelta, from: Address, message: &Message) {
        let requests = self.node.handle(self.clock.reading(world), from, message);
        self.apply_intervals(world, &requests);
    }

    pub(crate) fn next_frame(&mut self) -> Option<Vec<u8>> {
        let bytes = self.node.next_bytes();
        bytes.filter(|_| self.images.is_none())
    }

    /// Applies requested intervals of fixes to the images; ignores those of other messages.
    fn apply_intervals(&mut self, world: TimeDelta, requests: &[IntervalRequest]) {
        for request in requests {
            if request.message_id == ids::VISION_POSITION_ESTIMATE {
                self.interval = request.interval_or(TimeDelta::from_secs_f64(1.0 / self.settings.rate_hz));
                self.next_exposure = world;
            }
        }
    }

    /// Takes an image. Every image draws the same number of random values, so that one more outlier or dropout leaves
    /// the noise of the others as it was.
    fn expose(&mut self, world: TimeDelta, pose: Pose<Arena>) {
        let is_dropped =
            self.stream.bernoulli(self.settings.dropout) || self.settings.is_dark(world) || self.is_covered;
        let is_outlier = self.stream.bernoulli(self.settings.outlier);
        let gross = f64::from(u8::from(is_outlier));
        // An outlier's own error is drawn in either case.
        let mut error = |sigma: f64, outlier_sigma: f64| {
            sigma * self.stream.normal() + gross * outlier_sigma * self.stream.normal()
        };
        let x_error_m = error(self.settings.position_sigma_m, self.settings.outlier_sigma_m);
        let y_error_m = error(self.settings.position_sigma_m, self.settings.outlier_sigma_m);
        let heading_error_rad = error(self.settings.heading_sigma_deg, self.settings.outlier_sigma_deg).to_radians();
        let jitter_ms = self.settings.jitter_ms * self.stream.uniform(-1.0, 1.0);
        if is_dropped {
            return;
        }
        let latency_ms = (self.settings.latency_ms + jitter_ms).max(0.0);
        let due = world + TimeDelta::from_secs_f64(latency_ms * 1e-3);
        let sent = match self.settings.order {
            CameraOrder::Fifo if due < self.last_due => self.last_due,
            CameraOrder::Fifo | CameraOrder::Free => due,
        };
        self.last_due = sent;
        let tag = pose * Point2::<Body>::new(Meters(self.settings.tag_x_m), Meters(self.settings.tag_y_m));
        let [x_patch_m, y_patch_m] = self.patches.error_m(tag);
        let fix = CameraFix {
            exposed: world,
            sent,
            time: self.clock.reading(world),
            position: Point2::new(tag.x + Meters(x_error_m + x_patch_m), tag.y + Meters(y_error_m + y_patch_m)),
            heading: self.settings.sees_heading.then(|| pose.heading + Radians(heading_error_rad)),
            true_tag: Pose::new(tag.x, tag.y, pose.heading),
            is_outlier,
        };
        if let Some(images) = &mut self.images {
            self.image_count += 1;
            if images.len() >= MAX_IMAGES {
                images.pop_front();
            }
            let heading = fix.heading.unwrap_or(pose.heading);
            images.push_back(tag_image(self.image_count, fix.position, heading));
            return;
        }
        let index = self.pending.partition_point(|other| other.sent <= sent);
        self.pending.insert(index, fix);
    }

    fn message(&self, fix: &CameraFix) -> Message {
        let position_var_m2 = self.settings.position_sigma_m.powi(2);
        let heading_var_rad2 = if self.settings.sees_heading {
            self.settings.heading_sigma_deg.to_radians().powi(2)
        } else {
            f64::INFINITY
        };
        Message::VisionPosition(VisionFix {
            stamp: WireStamp::Micros64(fix.time.as_micros() as u64),
            x: fix.position.x,
            y: fix.position.y,
            heading: fix.heading,
            covariance: self.settings.reports_covariance.then_some([
                position_var_m2,
                0.0,
                position_var_m2,
                heading_var_rad2,
            ]),
            reset_counter: 0,
            tag: None,
        })
    }
}

/// The error of the camera's calibration: the same in every image of a tag on one square patch of the floor. Each patch has a random
/// stream of its own, so that none depends on the path of the robot.
#[derive(Clone, Copy, Debug)]
struct CalibrationPatches {
    seed: u64,
    sigma_m: f64,
    size_m: f64,
}

impl CalibrationPatches {
    /// Along x and y.
    fn error_m(self, tag: Point2<Arena>) -> [f64; 2] {
        // Whole numbers: as a float, zero would have two names.
        let [column, row] = [tag.x, tag.y].map(|along| (along.0 / self.size_m).round() as i64);
        let mut stream = RandomStream::new(self.seed, &format!("camera patch {column} {row}"));
        [(); 2].map(|()| self.sigma_m * stream.normal())
    }
}

/// The arena's origin in the image, pixels.
const ORIGIN_PX: [f64; 2] = [320.0, 240.0];
const METERS_PER_PX: f64 = 0.004;
const HALF_M: f64 = 0.05;
/// The corners in the tag's space, in halves of its side: forward, left.
const CORNERS: [[f64; 2]; 4] = [[-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0], [1.0, 1.0]];

/// One line of JSON without its line end: image number and corners of the tag.
fn tag_image(number: u64, tag: Point2<Arena>, heading: Heading) -> String {
    let tag = Pose::<Arena>::new(tag.x, tag.y, heading);
    let corners = CORNERS.map(|[forward, left]| {
        let corner = tag * Point2::<Body>::new(Meters(HALF_M * forward), Meters(HALF_M * left));
        let u_px = ORIGIN_PX[0] + corner.x.0 / METERS_PER_PX;
        let v_px = ORIGIN_PX[1] - corner.y.0 / METERS_PER_PX;
        format!("[{u_px:.3}, {v_px:.3}]")
    });
    format!("{{\"image\": {number}, \"corners_px\": [{}]}}", corners.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::rms;

    #[test]
    fn the_error_is_constant_on_a_patch_has_its_sigma_over_patches_and_differs_by_seed() {
        let patches = CalibrationPatches { seed: 3, sigma_m: 0.003, size_m: 0.5 };
        let at = |patches: CalibrationPatches, x_m, y_m| patches.error_m(Point2::new(Meters(x_m), Meters(y_m)));
        let center = at(patches, 0.0, 0.0);
        assert_eq!([at(patches, 0.24, -0.24), at(patches, -0.24, 0.1)], [center, center]);
        for other in
            [at(patches, 0.26, 0.0), at(patches, 0.0, -0.26), at(CalibrationPatches { seed: 4, ..patches }, 0.0, 0.0)]
        {
            assert_ne!(other, center);
        }
        // 3600 patches: their sigma is good to 1.2 %, their correlation with a neighbour to 0.017.
        let rows: Vec<Vec<f64>> = (0..60)
            .map(|row| (0..60).map(|column| at(patches, 0.5 * f64::from(column), 0.5 * f64::from(row))[0]).collect())
            .collect();
        let sigma = rms(rows.concat().into_iter());
        assert!((sigma / 0.003 - 1.0).abs() < 0.05, "{sigma}");
        let products: f64 = rows.iter().flat_map(|row| row.windows(2).map(|pair| pair[0] * pair[1])).sum();
        let correlation = products / (60.0 * 59.0) / sigma.powi(2);
        assert!(correlation.abs() < 0.07, "{correlation}");
    }

    #[test]
    fn a_tag_that_looks_north_has_its_front_above() {
        let heading = Heading::from_rad(std::f64::consts::FRAC_PI_2);
        let line = tag_image(7, Point2::new(Meters(0.4), Meters(0.2)), heading);
        assert_eq!(
            line,
            "{\"image\": 7, \"corners_px\": [[407.500, 202.500], [432.500, 202.500], \
             [432.500, 177.500], [407.500, 177.500]]}"
        );
    }
}
