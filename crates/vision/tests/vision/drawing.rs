//! Pictures of tags with exact corners, drawn by many samples for each pixel.

use nalgebra::{Matrix3, Point2, Vector3};
use posebridge_vision::tag36h11_modules;
use rand::RngExt;
use rand_distr::{Distribution, Normal};
use rand_pcg::Pcg32;

/// A view of the square from (0, 0) to (8, 8), with the tag's upper left corner first: to pixels.
pub(crate) type View = Matrix3<f64>;

/// What a camera does to a picture.
#[derive(Clone, Copy)]
pub(crate) struct Camera {
    pub(crate) black: f64,
    pub(crate) white: f64,
    /// Standard deviations: px, grey levels.
    pub(crate) blur_px: f64,
    pub(crate) noise: f64,
}

pub(crate) struct Picture {
    pub(crate) pixels: Vec<u8>,
    pub(crate) width: usize,
    pub(crate) height: usize,
}

/// A tag of about `side_px` at (x, y), turned, and tilted by `tilt` as perspective.
pub(crate) fn view(x: f64, y: f64, side_px: f64, turned_rad: f64, tilt: f64) -> View {
    let (sine, cosine) = turned_rad.sin_cos();
    let scale = side_px / 8.0;
    let centre = Matrix3::new(1.0, 0.0, -4.0, 0.0, 1.0, -4.0, 0.0, 0.0, 1.0);
    let turn = Matrix3::new(
        scale * cosine,
        -scale * sine,
        0.0,
        scale * sine,
        scale * cosine,
        0.0,
        tilt * 0.02,
        tilt * 0.035,
        1.0,
    );
    let place = Matrix3::new(1.0, 0.0, x, 0.0, 1.0, y, 0.0, 0.0, 1.0);
    place * turn * centre
}

pub(crate) fn corners(view: &View) -> [Point2<f64>; 4] {
    [(0.0, 0.0), (8.0, 0.0), (8.0, 8.0), (0.0, 8.0)].map(|(u, v)| {
        let at = view * Vector3::new(u, v, 1.0);
        Point2::new(at.x / at.z, at.y / at.z)
    })
}

/// Samples of a pixel. They lie in no rows (Roberts' R2 sequence): an edge along a row would pass all of it at once. Every other one
/// lies opposite to the one before, so that their middle is that of the pixel.
const SAMPLES: i32 = 400;
const STEPS: [f64; 2] = [0.754_877_666_246_693, 0.569_840_290_998_053];

/// Draws tags, each with its id, on a grey floor.
pub(crate) fn draw(width: usize, height: usize, tags: &[(u16, View)], camera: Camera, random: &mut Pcg32) -> Picture {
    let noise = Normal::new(0.0, camera.noise).unwrap();
    let floor = f64::midpoint(camera.black, camera.white);
    let inverses: Vec<_> =
        tags.iter().map(|(id, view)| (tag36h11_modules(*id).unwrap(), view.try_inverse().unwrap())).collect();
    let mut pixels = Vec::with_capacity(width * height);
    for y in 0..height {
        for x in 0..width {
            let (mut sum, mut weights) = (0.0, 0.0);
            for index in 0..SAMPLES {
                let reach = 3.0 * camera.blur_px.max(0.2);
                let [dx, dy] = STEPS.map(|step| {
                    let offset = (f64::from(index / 2) * step).fract() * 2.0 * reach - reach;
                    if index % 2 == 0 { offset } else { -offset }
                });
                let weight = (-(dx * dx + dy * dy) / (2.0 * camera.blur_px.powi(2))).exp();
                let at = Vector3::new(x as f64 + dx, y as f64 + dy, 1.0);
                let white = inverses.iter().find_map(|(modules, inverse)| {
                    let on_tag = inverse * at;
                    let module = |of: f64| (of / on_tag.z).floor() as i32 + 1;
                    let line = modules.get(usize::try_from(module(on_tag.y)).ok()?)?;
                    line.get(usize::try_from(module(on_tag.x)).ok()?).copied()
                });
                let grey = match white {
                    Some(true) => camera.white,
                    Some(false) => camera.black,
                    None => floor,
                };
                sum += weight * grey;
                weights += weight;
            }
            pixels.push((sum / weights + noise.sample(random)).round().clamp(0.0, 255.0) as u8);
        }
    }
    Picture { pixels, width, height }
}

/// A picture of nothing but bars and noise.
pub(crate) fn draw_clutter(width: usize, height: usize, random: &mut Pcg32) -> Picture {
    let noise = Normal::new(0.0, 3.0).unwrap();
    let mut pixels = vec![128.0; width * height];
    for _ in 0..60 {
        let (left, top) = (random.random_range(0..width), random.random_range(0..height));
        let grey = random.random_range(10.0..245.0);
        for y in top..(top + random.random_range(2..40)).min(height) {
            let right = (left + random.random_range(30..33)).min(width);
            pixels[y * width + left..y * width + right].fill(grey);
        }
    }
    let pixels = pixels.into_iter().map(|grey: f64| (grey + noise.sample(random)).clamp(0.0, 255.0) as u8);
    Picture { pixels: pixels.collect(), width, height }
}
