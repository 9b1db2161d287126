//! A camera whose pictures are rendered: the floor of the arena with tags on it and on robots, in grey, as JPEG.
//!
//! # Model
//! ```text
//! light      of each floor point or print, constant; brighter to one side; the sensor is linear
//! lens       pinhole and two radial terms; a Gaussian blur
//! pixel      the mean over its area
//! row r      sees the mean of what is there in t(r) +- exposure / 2,   t(r) = mid + line time (r - (rows - 1) / 2)
//! noise      of each pixel, variance = read² + shot * level; then rounded to 0..255
//! ```
//! A tag on a robot is a piece of paper that floats at its height: the robot below it is not drawn, and nothing throws a shadow.
//!
//! What stands still is rendered once. A frame draws the surroundings of the moving tags anew, and the noise.

mod blur;
mod exposure;
mod exposure_recorder;
mod floor_texture;
mod frame_schedule;
mod jpeg;
mod printed_tag;
mod projection;
mod sensor_noise;

use posebridge_telemetry::{Arena, Heading, Meters, Pose, TimeDelta};

use crate::config_file::ConfigFileError;
use crate::scenario::{RenderedCameraSettings, RobotTagSettings};
use blur::{Blur, PixelBox};
use floor_texture::FloorTexture;
use printed_tag::{PrintedTag, TagSample};
use projection::CornerRays;
use sensor_noise::SensorNoise;

pub use exposure::{Exposure, LensState};
pub(crate) use exposure_recorder::ExposureRecorder;
pub use frame_schedule::{FrameSchedule, FrameTimes};
pub use jpeg::encode_jpeg;
pub use projection::Projection;

/// Samples of a pixel across and down: of the floor, of a tag.
const FLOOR_SAMPLES: usize = 2;
const TAG_SAMPLES: usize = 2;
/// Poses by which the surroundings of a moving tag are found: enough for a tag that turns by an eighth between two.
const BOX_POSES: i64 = 8;
/// A tag that moves less than this during an exposure stands still, px.
const STILL_PX: f64 = 0.01;
/// Poses of a moving tag in the exposure of a row: at least and at most, and for each pixel of its way.
const MIN_POSES: usize = 4;
const MAX_POSES: usize = 64;
const POSES_PER_PX: f64 = 2.0;
/// Grey level of a picture without light.
const DARK_LEVEL: f32 = 4.0;

/// A tag that moves. The pose is that of its middle, its way up as heading.
pub struct MovingTag<'a> {
    pub tag: RobotTagSettings,
    pub pose: &'a mut dyn FnMut(TimeDelta) -> Pose<Arena>,
}

/// A picture as its receiver gets it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RenderedFrame {
    pub number: u64,
    /// True middle of the exposure of the picture's middle row.
    pub exposure_mid: TimeDelta,
    /// When it is delivered.
    pub due: TimeDelta,
    pub jpeg: Vec<u8>,
}

/// The pictures of a camera.
#[derive(Clone, Debug)]
pub struct RenderedCamera {
    settings: RenderedCameraSettings,
    projection: Projection,
    rays: CornerRays,
    width: usize,
    height: usize,
    /// Brightness of what stands still, white paper being 1, before the lens; in `scene` with the moving tags.
    still: Vec<f32>,
    scene: Vec<f32>,
    /// Grey levels of what stands still, behind the lens.
    still_signal: Vec<f32>,
    blur: Blur,
    noise: SensorNoise,
    pixels: Vec<u8>,
}

impl RenderedCamera {
    /// Renders what stands still, which takes as long as some dozens of frames. `seed` chooses floor and noise.
    ///
    /// # Errors
    /// [`ConfigFileError::Impossible`] with the name of the key, if settings contradict each other.
    pub fn new(settings: &RenderedCameraSettings, seed: u64) -> Result<Self, ConfigFileError> {
        if let Some(reason) = settings.contradiction() {
            return Err(ConfigFileError::Impossible { what: "camera", reason });
        }
        let (width, height) = (usize::from(settings.width_px), usize::from(settings.height_px));
        let projection = Projection::new(settings);
        let mut camera = Self {
            settings: settings.clone(),
            projection,
            rays: CornerRays::new(&projection, width, height),
            width,
            height,
            still: Vec::new(),
            scene: Vec::new(),
            still_signal: Vec::new(),
            blur: Blur::new(settings.blur_px),
            noise: SensorNoise::new(seed, width, settings.read_noise, settings.shot_noise),
            pixels: vec![0; width * height],
        };
        camera.render_still(&FloorTexture::new(seed));
        Ok(camera)
    }

    pub const fn settings(&self) -> &RenderedCameraSettings {
        &self.settings
    }

    pub const fn projection(&self) -> &Projection {
        &self.projection
    }

    /// The frame of an exposure of the robot's tag.
    pub fn take_picture(&mut self, exposure: &Exposure) -> RenderedFrame {
        let mut pose = |time| exposure.tag_pose(time);
        let tag = MovingTag { tag: self.settings.robot_tag, pose: &mut pose };
        let RenderedCameraSettings { width_px, height_px, jpeg_quality, .. } = self.settings;
        let FrameTimes { number, mid, due, .. } = exposure.times;
        let pixels = self.render(number, mid, exposure.lens, &mut [tag]);
        let jpeg = encode_jpeg(pixels, width_px, height_px, jpeg_quality).unwrap_or_default();
        RenderedFrame { number, exposure_mid: mid, due, jpeg }
    }

    /// Renders a frame, in rows. `mid` is the middle of the exposure of the picture's middle row. The same number gives the same noise.
    pub fn render(&mut self, number: u64, mid: TimeDelta, lens: LensState, tags: &mut [MovingTag<'_>]) -> &[u8] {
        self.noise.begin_frame(number, self.height);
        if lens == LensState::Covered {
            let dark = vec![DARK_LEVEL; self.width];
            for (row, pixels) in self.pixels.chunks_mut(self.width).enumerate() {
                self.noise.expose(row, 0, &dark, pixels);
            }
            return &self.pixels;
        }
        let rows = self.still_signal.chunks(self.width).zip(self.pixels.chunks_mut(self.width));
        for (row, (signal, pixels)) in rows.enumerate() {
            self.noise.expose(row, 0, signal, pixels);
        }
        let boxes: Vec<PixelBox> = tags.iter_mut().filter_map(|tag| self.draw_moving(mid, tag)).collect();
        let mut signal = Vec::new();
        for drawn in &boxes {
            let area = drawn.grown(self.blur.reach(), self.width, self.height);
            self.blur.run(&self.scene, self.width, area, &mut signal);
            for (row, signal) in area.rows().zip(signal.chunks_mut(area.right - area.left)) {
                self.illuminate(row, area.left, signal);
                let pixels = &mut self.pixels[row * self.width + area.left..row * self.width + area.right];
                self.noise.expose(row, area.left, signal, pixels);
            }
        }
        for drawn in boxes {
            for row in drawn.rows() {
                let range = row * self.width + drawn.left..row * self.width + drawn.right;
                self.scene[range.clone()].copy_from_slice(&self.still[range]);
            }
        }
        &self.pixels
    }

    fn render_still(&mut self, floor: &FloorTexture) {
        self.still = Vec::with_capacity(self.width * self.height);
        for row in 0..self.height {
            for column in 0..self.width {
                let corners = self.rays.corners_at(column, row, 0.0);
                let sum: f32 = samples::<FLOOR_SAMPLES>().map(|at| floor.brightness(inside(&corners, at))).sum();
                self.still.push(sum / (FLOOR_SAMPLES * FLOOR_SAMPLES) as f32);
            }
        }
        self.scene = self.still.clone();
        for tag in &self.settings.floor_tags.clone() {
            let pose = Pose::new(Meters(tag.x_m), Meters(tag.y_m), Heading::from_rad(tag.heading_deg.to_radians()));
            let printed = RobotTagSettings { id: tag.id, side_m: tag.side_m, height_m: 0.0 };
            self.draw_moving(TimeDelta::ZERO, &mut MovingTag { tag: printed, pose: &mut |_| pose });
        }
        self.still.clone_from(&self.scene);
        let whole = PixelBox { left: 0, top: 0, right: self.width, bottom: self.height };
        let mut signal = Vec::with_capacity(self.still.len());
        self.blur.run(&self.still, self.width, whole, &mut signal);
        for (row, signal) in signal.chunks_mut(self.width).enumerate() {
            self.illuminate(row, 0, signal);
        }
        self.still_signal = signal;
    }

    /// Turns brightness into grey levels, from the column `left` on.
    fn illuminate(&self, row: usize, left: usize, brightness: &mut [f32]) {
        let [right, down] = self.settings.light_change;
        let share = |index: usize, count: usize| (index as f64 + 0.5) / count as f64 - 0.5;
        let of_row = 1.0 + down * share(row, self.height);
        for (column, value) in brightness.iter_mut().enumerate() {
            let light = of_row + right * share(left + column, self.width);
            *value *= (self.settings.white_level * light) as f32;
        }
    }

    /// Draws a tag into the scene as it is seen by each row during its exposure. Returns the pixels that may have changed.
    fn draw_moving(&mut self, mid: TimeDelta, moving: &mut MovingTag<'_>) -> Option<PixelBox> {
        let printed = PrintedTag::new(moving.tag.id, moving.tag.side_m)?;
        let exposure_ns = self.settings.exposure().as_nanos();
        let height_m = moving.tag.height_m;
        let area = self.surroundings(&printed, mid, moving)?;
        let count = self.poses_needed(&printed, mid, moving);
        let mut poses = Vec::with_capacity(count);
        for row in area.rows() {
            let row_mid = mid + self.row_delay(row);
            poses.clear();
            for index in 0..count {
                let share = (index as f64 + 0.5) / count as f64 - 0.5;
                let time = row_mid + TimeDelta::from_nanos((share * exposure_ns as f64) as i64);
                poses.push(TagFrame::new((moving.pose)(time)));
            }
            for column in area.columns() {
                let corners = self.rays.corners_at(column, row, height_m);
                let seen = mean_sample(&printed, &corners, &poses);
                let pixel = &mut self.scene[row * self.width + column];
                *pixel += seen.brightness - seen.cover * *pixel;
            }
        }
        Some(area)
    }

    /// From the middle of the frame's exposure to that of a row.
    fn row_delay(&self, row: usize) -> TimeDelta {
        let rows = row as f64 - (self.height as f64 - 1.0) / 2.0;
        TimeDelta::from_secs_f64(rows * self.settings.line_time_us * 1e-6)
    }

    /// The pixels that a tag may be seen by during a frame; `None` if there are none.
    fn surroundings(&self, printed: &PrintedTag, mid: TimeDelta, moving: &mut MovingTag<'_>) -> Option<PixelBox> {
        let span_ns = (self.settings.exposure() + self.settings.readout()).as_nanos();
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        let mut last: Option<[[f64; 2]; 4]> = None;
        let mut step = 0.0_f64;
        for index in 0..=BOX_POSES {
            let time = mid + TimeDelta::from_nanos(span_ns * index / BOX_POSES - span_ns / 2);
            let corners = self.paper_corners(printed, (moving.pose)(time), moving.tag.height_m)?;
            for corner in corners {
                for axis in 0..2 {
                    low[axis] = low[axis].min(corner[axis]);
                    high[axis] = high[axis].max(corner[axis]);
                }
            }
            step = step.max(last.map_or(0.0, |last| farthest(&last, &corners)));
            last = Some(corners);
        }
        // What bends between two poses, and the softness of edges.
        let margin = 2.0 + step / 4.0;
        let begin = |axis: usize, size: usize| (low[axis] - margin).floor().clamp(0.0, size as f64) as usize;
        let end = |axis: usize, size: usize| (high[axis] + margin).ceil().clamp(0.0, size as f64) as usize;
        let area = PixelBox {
            left: begin(0, self.width),
            top: begin(1, self.height),
            right: end(0, self.width),
            bottom: end(1, self.height),
        };
        (area.left < area.right && area.top < area.bottom).then_some(area)
    }

    /// How many poses show the motion in the exposure of a row.
    fn poses_needed(&self, printed: &PrintedTag, mid: TimeDelta, moving: &mut MovingTag<'_>) -> usize {
        let half = TimeDelta::from_nanos(self.settings.exposure().as_nanos() / 2);
        let height_m = moving.tag.height_m;
        // The middle row's exposure is as long as any other, and robots hardly change their speed within a frame.
        let mut corners = |time| self.paper_corners(printed, (moving.pose)(time), height_m);
        let (Some(first), Some(last)) = (corners(mid - half), corners(mid + half)) else { return MIN_POSES };
        let moved_px = farthest(&first, &last);
        if moved_px < STILL_PX {
            return 1;
        }
        ((POSES_PER_PX * moved_px).ceil() as usize).clamp(MIN_POSES, MAX_POSES)
    }

    /// The pixels of the corners of a tag's paper. `None` if one is behind the camera.
    fn paper_corners(&self, printed: &PrintedTag, pose: Pose<Arena>, height_m: f64) -> Option<[[f64; 2]; 4]> {
        let half_m = printed.half_m();
        let (sin, cos) = pose.heading.rad().sin_cos();
        let mut pixels = [[0.0; 2]; 4];
        for (pixel, [up, left]) in pixels.iter_mut().zip([[1.0, 1.0], [1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0]]) {
            let (up_m, left_m) = (up * half_m, left * half_m);
            let x_m = pose.x.0 + cos * up_m - sin * left_m;
            let y_m = pose.y.0 + sin * up_m + cos * left_m;
            *pixel = self.projection.pixel_of([x_m, y_m, height_m])?;
        }
        Some(pixels)
    }
}

/// A tag's axes in the arena.
#[derive(Clone, Copy, Debug)]
struct TagFrame {
    x_m: f32,
    y_m: f32,
    cos: f32,
    sin: f32,
}

impl TagFrame {
    fn new(pose: Pose<Arena>) -> Self {
        let (sin, cos) = pose.heading.rad().sin_cos();
        Self { x_m: pose.x.0 as f32, y_m: pose.y.0 as f32, cos: cos as f32, sin: sin as f32 }
    }
}

/// What a pixel sees of a tag, as mean over its area and over the poses. `corners` are the points that its corners show.
fn mean_sample(printed: &PrintedTag, corners: &[[f32; 2]; 4], poses: &[TagFrame]) -> TagSample {
    let [upper_left, upper_right, lower_left, _] = *corners;
    // The sides of the part of the pixel that one sample stands for.
    let sides =
        [upper_right, lower_left].map(|to| [0, 1].map(|axis| (to[axis] - upper_left[axis]) / TAG_SAMPLES as f32));
    let mut sum = TagSample::default();
    for pose in poses {
        let [up, left] = [[pose.cos, pose.sin], [-pose.sin, pose.cos]];
        let along = |axis: [f32; 2]| sides.map(|side| axis[0] * side[0] + axis[1] * side[1]);
        let softness = [printed.softness(along(up)), printed.softness(along(left))];
        for at in samples::<TAG_SAMPLES>() {
            let [x_m, y_m] = inside(corners, at);
            let (east_m, north_m) = (x_m - pose.x_m, y_m - pose.y_m);
            let (up_m, left_m) = (up[0] * east_m + up[1] * north_m, left[0] * east_m + left[1] * north_m);
            let sample = printed.sample(up_m, left_m, softness);
            sum.cover += sample.cover;
            sum.brightness += sample.brightness;
        }
    }
    let count = (TAG_SAMPLES * TAG_SAMPLES * poses.len()) as f32;
    TagSample { cover: sum.cover / count, brightness: sum.brightness / count }
}

/// The middles of `COUNT` x `COUNT` equal parts of a pixel, right and down from its upper left corner.
fn samples<const COUNT: usize>() -> impl Iterator<Item = [f32; 2]> {
    let middle = |index: usize| (index as f32 + 0.5) / COUNT as f32;
    (0..COUNT * COUNT).map(move |index| [middle(index % COUNT), middle(index / COUNT)])
}

/// Between the four corners of a pixel. A pixel is so small that perspective does not show in it.
fn inside(corners: &[[f32; 2]; 4], [right, down]: [f32; 2]) -> [f32; 2] {
    let [upper_left, upper_right, lower_left, lower_right] = corners;
    [0, 1].map(|axis| {
        let upper = upper_left[axis] + right * (upper_right[axis] - upper_left[axis]);
        let lower = lower_left[axis] + right * (lower_right[axis] - lower_left[axis]);
        upper + down * (lower - upper)
    })
}

/// The longest way of a corner, px.
fn farthest(from: &[[f64; 2]; 4], to: &[[f64; 2]; 4]) -> f64 {
    from.iter().zip(to).map(|(from, to)| (to[0] - from[0]).hypot(to[1] - from[1])).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 200 px a metre: a module of 12.5 mm is 2.5 px. A sum over pixels is not quite the integral over their area, which shows where all
    /// edges lie alike to them: a few thousandths of a pixel.
    #[test]
    fn a_turned_tag_has_its_area_its_black_and_both_in_its_middle() {
        let settings = RenderedCameraSettings {
            x_m: 0.0,
            y_m: 0.0,
            height_m: 3.0,
            tilt_deg: 0.0,
            radial: [0.0; 2],
            ..Default::default()
        };
        let rays = CornerRays::new(&Projection::new(&settings), 640, 480);
        let printed = PrintedTag::new(7, 0.1).unwrap();
        let modules = posebridge_vision::tag36h11_modules(7).unwrap();
        for step in 0..24 {
            let heading = 0.1 + 0.15 * f64::from(step);
            let (x_m, y_m) = (0.3 + 0.000_7 * f64::from(step), 0.2 - 0.001_1 * f64::from(step));
            let pose = TagFrame::new(Pose::new(Meters(x_m), Meters(y_m), Heading::from_rad(heading)));
            // Of cover and brightness: sum, and moments to the right and down of the tag's middle, px.
            let (mut found, mut expected) = ([[0.0; 3]; 2], [[0.0; 3]; 2]);
            let add = |sums: &mut [[f64; 3]; 2], weights: [f64; 2], right: f64, down: f64| {
                for (sums, weight) in sums.iter_mut().zip(weights) {
                    for (sum, moment) in sums.iter_mut().zip([1.0, right, down]) {
                        *sum += weight * moment;
                    }
                }
            };
            let (column, row) = (319.5 + 200.0 * x_m, 239.5 - 200.0 * y_m);
            for y in row as usize - 25..row as usize + 26 {
                for x in column as usize - 25..column as usize + 26 {
                    let seen = mean_sample(&printed, &rays.corners_at(x, y, 0.0), &[pose]);
                    let weights = [seen.cover, seen.brightness].map(f64::from);
                    add(&mut found, weights, x as f64 - column, y as f64 - row);
                }
            }
            for (line, modules) in modules.iter().enumerate() {
                for (place, is_white) in modules.iter().enumerate() {
                    let [up, left] = [line, place].map(|index| 2.5 * (4.5 - index as f64));
                    let (sin, cos) = heading.sin_cos();
                    let brightness = if *is_white { 1.0 } else { 0.08 };
                    let weights = [6.25, 6.25 * brightness];
                    add(&mut expected, weights, cos * up - sin * left, -(sin * up + cos * left));
                }
            }
            for (found, expected) in found.iter().zip(expected) {
                assert!((found[0] / expected[0] - 1.0).abs() < 5e-4, "step {step}: {found:?} {expected:?}");
                for axis in 1..3 {
                    let shift_px = found[axis] / found[0] - expected[axis] / expected[0];
                    assert!(shift_px.abs() < 0.005, "step {step}: {shift_px} px");
                }
            }
        }
    }
}
