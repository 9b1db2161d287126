//! From the arena to the picture and back: a pinhole with radial distortion (Brown, 1966).
//!
//! Written from the physics and not from the detector's camera model, so that an error of either shows.

use crate::scenario::RenderedCameraSettings;

/// Halvings of an interval: to the last bit of an `f64`.
const HALVINGS: usize = 60;
/// Rays that fall less steeply than this tangent meet the floor too far away to show a tag.
const MIN_FALL: f64 = 0.02;

type Vector = [f64; 3];

/// Where a camera is, and where its pixels look.
#[derive(Clone, Copy, Debug)]
pub struct Projection {
    focal_px: f64,
    axis_px: [f64; 2],
    radial: [f64; 2],
    position_m: Vector,
    /// The camera's right, down and ahead, as directions in the arena.
    axes: [Vector; 3],
}

impl Projection {
    pub fn new(settings: &RenderedCameraSettings) -> Self {
        let (sin_tilt, cos_tilt) = settings.tilt_deg.to_radians().sin_cos();
        let (sin_azimuth, cos_azimuth) = settings.azimuth_deg.to_radians().sin_cos();
        let right = [sin_azimuth, -cos_azimuth, 0.0];
        let down = [-cos_tilt * cos_azimuth, -cos_tilt * sin_azimuth, -sin_tilt];
        let ahead = [sin_tilt * cos_azimuth, sin_tilt * sin_azimuth, -cos_tilt];
        Self {
            focal_px: settings.focal_px,
            axis_px: settings.axis_px(),
            radial: settings.radial,
            position_m: [settings.x_m, settings.y_m, settings.height_m],
            axes: [right, down, ahead],
        }
    }

    pub const fn position_m(&self) -> [f64; 3] {
        self.position_m
    }

    /// The camera's right, down and ahead, as directions in the arena.
    pub const fn axes(&self) -> [[f64; 3]; 3] {
        self.axes
    }

    /// The pixel of a point in the arena; the centre of the first pixel is (0, 0). `None` behind the camera.
    pub fn pixel_of(&self, point_m: [f64; 3]) -> Option<[f64; 2]> {
        let offset = [0, 1, 2].map(|axis| point_m[axis] - self.position_m[axis]);
        let [right, down, ahead] = self.axes.map(|axis| dot(axis, offset));
        if ahead <= 0.0 {
            return None;
        }
        let (x, y) = (right / ahead, down / ahead);
        let distorted = self.distort(x.hypot(y)) / x.hypot(y).max(f64::MIN_POSITIVE);
        let factor = if x == 0.0 && y == 0.0 { 1.0 } else { distorted };
        Some([self.axis_px[0] + self.focal_px * factor * x, self.axis_px[1] + self.focal_px * factor * y])
    }

    /// The point of the arena that a pixel shows at `height_m` above the floor. `None` above the horizon or close below it.
    pub fn point_at_height(&self, pixel: [f64; 2], height_m: f64) -> Option<[f64; 2]> {
        let [east, north] = self.run(pixel)?;
        let drop_m = self.position_m[2] - height_m;
        Some([self.position_m[0] + east * drop_m, self.position_m[1] + north * drop_m])
    }

    /// How far a pixel's ray goes along x and y of the arena while it falls by one. `None` above the horizon or close below it.
    pub(crate) fn run(&self, pixel: [f64; 2]) -> Option<[f64; 2]> {
        let x = (pixel[0] - self.axis_px[0]) / self.focal_px;
        let y = (pixel[1] - self.axis_px[1]) / self.focal_px;
        let distorted = x.hypot(y);
        let factor = if distorted > 0.0 { self.undistort(distorted) / distorted } else { 1.0 };
        let [right, down, ahead] = self.axes;
        let ray = [0, 1, 2].map(|axis| factor * (x * right[axis] + y * down[axis]) + ahead[axis]);
        let fall = -ray[2];
        (fall > MIN_FALL * ray[0].hypot(ray[1])).then_some([ray[0] / fall, ray[1] / fall])
    }

    /// Of a distance from the axis, as a tangent.
    fn distort(&self, distance: f64) -> f64 {
        let [second, fourth] = self.radial;
        distance + second * distance.powi(3) + fourth * distance.powi(5)
    }

    /// By bisection: slow, but without a derivative that could be wrong. The distortion rises up to the picture's corners, which the
    /// settings guarantee.
    fn undistort(&self, distorted: f64) -> f64 {
        let (mut low, mut high) = (0.0, distorted);
        while self.distort(high) < distorted && high < 4.0 * distorted {
            high += 0.125 * distorted;
        }
        for _ in 0..HALVINGS {
            let middle = f64::midpoint(low, high);
            if self.distort(middle) < distorted {
                low = middle;
            } else {
                high = middle;
            }
        }
        f64::midpoint(low, high)
    }
}

fn dot(one: Vector, other: Vector) -> f64 {
    one[0] * other[0] + one[1] * other[1] + one[2] * other[2]
}

/// Where the corners of the pixels look: the rays of [`Projection::run`] for each corner of each pixel, in rows.
#[derive(Clone, Debug)]
pub(crate) struct CornerRays {
    runs: Vec<[f32; 2]>,
    columns: usize,
    position_m: Vector,
}

impl CornerRays {
    pub(crate) fn new(projection: &Projection, width: usize, height: usize) -> Self {
        let columns = width + 1;
        let mut runs = Vec::with_capacity(columns * (height + 1));
        for row in 0..=height {
            for column in 0..columns {
                let corner = [column as f64 - 0.5, row as f64 - 0.5];
                // Not a number where the floor is out of sight: no comparison with it is true.
                runs.push(projection.run(corner).map_or([f32::NAN; 2], |run| run.map(|along| along as f32)));
            }
        }
        Self { runs, columns, position_m: projection.position_m() }
    }

    /// The points at a height above the floor that the four corners of a pixel show: upper left, upper right, lower left, lower right.
    pub(crate) fn corners_at(&self, column: usize, row: usize, height_m: f64) -> [[f32; 2]; 4] {
        let upper = row * self.columns + column;
        let drop_m = (self.position_m[2] - height_m) as f32;
        let [x_m, y_m] = [self.position_m[0] as f32, self.position_m[1] as f32];
        [upper, upper + 1, upper + self.columns, upper + self.columns + 1].map(|index| {
            let [east, north] = self.runs.get(index).copied().unwrap_or([f32::NAN; 2]);
            [x_m + drop_m * east, y_m + drop_m * north]
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pixel_shows_the_point_that_it_shows() {
        let settings = RenderedCameraSettings { tilt_deg: 41.0, azimuth_deg: 17.0, ..Default::default() };
        let projection = Projection::new(&settings);
        for pixel in [[0.0, 0.0], [639.0, 0.0], [12.5, 470.25], [319.5, 239.5], [400.0, 300.0]] {
            let [x_m, y_m] = projection.point_at_height(pixel, 0.085).unwrap();
            let [right, down] = projection.pixel_of([x_m, y_m, 0.085]).unwrap();
            assert!((right - pixel[0]).abs() < 1e-9 && (down - pixel[1]).abs() < 1e-9, "{pixel:?}: {right} {down}");
        }
    }

    #[test]
    fn a_camera_that_looks_straight_down_has_its_azimuth_above() {
        let settings = RenderedCameraSettings {
            x_m: 1.0,
            y_m: 2.0,
            height_m: 2.0,
            tilt_deg: 0.0,
            azimuth_deg: 90.0,
            radial: [0.0, 0.0],
            ..Default::default()
        };
        // 600 px at 2 m: 300 px a metre.
        let pixel = Projection::new(&settings).pixel_of([1.1, 2.2, 0.0]).unwrap();
        assert!((pixel[0] - 349.5).abs() < 1e-9 && (pixel[1] - 179.5).abs() < 1e-9, "{pixel:?}");
        assert_eq!(Projection::new(&settings).pixel_of([1.0, 2.0, 2.5]), None);
    }
}
