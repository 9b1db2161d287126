//! Corners to a fraction of a pixel: the whole pattern of a recognised tag, blurred, is laid over the picture.
//!
//! The residuals of single pixels are minimised over the perspective, the bend of the lens, black, white and the blur across both directions
//! of the tag's edges (Gauss-Newton). So all edges between modules measure, not only the outermost; and the normal matrix is the corners'
//! covariance.

use nalgebra::{Point2, SMatrix, SVector, Vector2};

use crate::blurred_pattern::BlurredPattern;
use crate::grey_image::GreyImage;
use crate::homography::{Bend, Homography, LensAxis};
use crate::tag36h11::{SIDE, tag36h11_modules};

/// Eight of the perspective, the bend of the lens (its k1), black, white, two of the blur.
const PARAMETERS: usize = 13;
const BEND: usize = 8;
const BLACK: usize = 9;
const WHITE: usize = 10;
const BLUR: usize = 11;
/// The perspective and the bend, which tell where the corners are.
const SHAPE: usize = 9;
/// Most iterations, and the change of the corners that ends them, px.
const MAX_ITERATIONS: usize = 10;
const CONVERGED: f64 = 0.06;
const COARSE_CONVERGED: f64 = 0.1;
/// Most that corners may move, px and parts of a module.
const MAX_SHIFT: f64 = 1.0;
const MAX_SHIFT_MODULES: f64 = 0.7;
/// Of a large tag not all pixels are looked at, and not all of those near edges are compared; in the first steps every n-th.
const LOOKED_AT: f64 = 3500.0;
const PIXELS: f64 = 1500.0;
const COARSE: usize = 4;
/// How far from an edge pixels are compared, px.
const EDGE_REACH: f64 = 2.5;
/// How far outside the rim pixels are compared, modules. Beyond the white there may be anything, so that it is less where the blur
/// carries that into the white: so far from its end, px.
const OUTSIDE: f64 = 0.5;
const WHITE_MARGIN: f64 = 1.5;
/// How far inside the rim's outer edge pixels are compared while the bits are unknown, modules.
const RIM_DEPTH: f64 = 0.7;
/// Standard deviation of the blur before anything is known, px, and its bounds.
const USUAL_BLUR: f64 = 0.8;
const BLUR_BOUNDS: (f64, f64) = (0.35, 5.0);
/// Standard deviation of k1 among lenses of cameras, and most of it. A small tag says nothing of it, its k1 stays near zero. With 0.3,
/// dim tags through a straight lens lose twice as much.
const USUAL_BEND: f64 = 0.15;
const MAX_BEND: f64 = 0.45;
/// Far from the place, residuals are no noise and would be taken for a bend: how much more their variance counts there.
const FIRST_DOUBT: f64 = 6.0;
/// Most that -k1 shortens the farthest pixel: at a third the picture is folded back.
const MAX_SHORTENING: f64 = 0.25;
/// Residuals beyond so many standard deviations count less (Huber).
const HUBER: f64 = 2.5;

/// The corners of a tag, and how well they are known.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RefinedCorners {
    pub(crate) corners: [Point2<f64>; 4],
    /// Of x and y of the corners, px².
    pub(crate) covariance: SMatrix<f64, 8, 8>,
}

/// The pattern of a tag and the part of the picture that it is compared with.
pub(crate) struct Refinement<'a> {
    image: GreyImage<'a>,
    pattern: BlurredPattern,
    axis: LensAxis,
    /// The tag's middle, around which the lens bends.
    middle: Point2<f64>,
    /// Least and most k1.
    bend_bounds: (f64, f64),
    /// Columns and rows to compare, with their grey levels.
    pixels: Vec<(f64, f64, f64)>,
}

struct Fit {
    parameters: SVector<f64, PARAMETERS>,
    normal: SMatrix<f64, PARAMETERS, PARAMETERS>,
    right: SVector<f64, PARAMETERS>,
    /// Weighted sum of squared residuals.
    cost: f64,
    /// Of the residuals, at least of rounded grey levels.
    variance: f64,
}

impl Fit {
    /// The parameters after a damped step (Levenberg-Marquardt) from those with this `bend`, which stays within `bounds`; the
    /// prior is one to residuals of this `variance`.
    fn step(&self, damping: f64, bend: &Bend, bounds: (f64, f64), variance: f64) -> Option<SVector<f64, PARAMETERS>> {
        let mut damped = self.normal_with_prior(variance);
        let mut right = self.right;
        right[BEND] -= variance * self.parameters[BEND] / USUAL_BEND.powi(2);
        for index in 0..PARAMETERS {
            damped[(index, index)] *= 1.0 + damping;
        }
        let mut step = damped.cholesky()?.solve(&right);
        let mut k1 = bend.k1_after(step[BEND]);
        if !(bounds.0..=bounds.1).contains(&k1) {
            // The others' step with the bound is another one than that with the bend that they were solved with.
            k1 = k1.clamp(bounds.0, bounds.1);
            let bounded = bend.step_to(k1);
            right -= damped.column(BEND) * bounded;
            damped.fill_row(BEND, 0.0);
            damped.fill_column(BEND, 0.0);
            damped[(BEND, BEND)] = 1.0;
            right[BEND] = bounded;
            step = damped.cholesky()?.solve(&right);
        }
        let mut next = self.parameters + step;
        next[BEND] = k1;
        for index in [BLUR, BLUR + 1] {
            next[index] = next[index].clamp(BLUR_BOUNDS.0.ln(), BLUR_BOUNDS.1.ln());
        }
        Some(next)
    }

    /// With what is known of lenses, in units of residuals with a `variance`.
    fn normal_with_prior(&self, variance: f64) -> SMatrix<f64, PARAMETERS, PARAMETERS> {
        let mut normal = self.normal;
        normal[(BEND, BEND)] += variance / USUAL_BEND.powi(2);
        normal
    }

    /// Of the residuals and of an unusual lens.
    fn cost_with_prior(&self, variance: f64) -> f64 {
        self.cost + variance * (self.parameters[BEND] / USUAL_BEND).powi(2)
    }
}

impl<'a> Refinement<'a> {
    /// Of the tag `id`; without one only the rim's outer edge is compared. `modules` maps the tag to pixels.
    pub(crate) fn new(image: GreyImage<'a>, axis: LensAxis, id: Option<u16>, modules: &Homography) -> Option<Self> {
        let mut one = Self {
            image,
            pattern: BlurredPattern::new(tag36h11_modules(id.unwrap_or(0))?),
            axis,
            middle: modules.map(SIDE as f64 / 2.0, SIDE as f64 / 2.0),
            bend_bounds: (0.0, 0.0),
            pixels: Vec::new(),
        };
        let inner = if id.is_some() { SIDE as f64 } else { RIM_DEPTH };
        one.choose_pixels(modules, inner)?;
        // The rim alone is too little to tell a bend from the perspective.
        if id.is_some() {
            let farthest = one.pixels.iter().map(|(x, y, _)| axis.ray(*x, *y).norm_squared()).fold(0.0, f64::max);
            let unbent = farthest / (1.0 - MAX_SHORTENING).powi(2);
            one.bend_bounds = ((-MAX_SHORTENING / unbent).max(-MAX_BEND), MAX_BEND);
        }
        Some(one)
    }

    /// Chooses those at most `inner` modules inside the rim's outer edge.
    fn choose_pixels(&mut self, modules: &Homography, inner: f64) -> Option<()> {
        let inverse = modules.inverse()?;
        let side = SIDE as f64;
        let area = |corners: &[Point2<f64>; 4]| -> f64 {
            (0..4).map(|corner| corners[corner].coords.perp(&corners[(corner + 1) % 4].coords) / 2.0).sum()
        };
        let square = [(0.0, 0.0), (side, 0.0), (side, side), (0.0, side)];
        let module_px = (area(&square.map(|(u, v)| modules.map(u, v))).max(1.0).sqrt() / side).max(1.0);
        let outside = (1.0 - WHITE_MARGIN / module_px).clamp(0.0, OUTSIDE);
        let outer = square.map(|(u, v)| {
            let out = |of: f64| if of > 0.0 { of + outside } else { of - outside };
            modules.map(out(u), out(v))
        });
        let (mut left, mut right, mut top, mut bottom) = (f64::MAX, f64::MIN, f64::MAX, f64::MIN);
        for at in &outer {
            (left, right) = (left.min(at.x), right.max(at.x));
            (top, bottom) = (top.min(at.y), bottom.max(at.y));
        }
        let limit = |of: f64, size: usize| of.clamp(0.0, size as f64 - 1.0);
        let columns =
            limit(left.ceil(), self.image.width()) as usize..=limit(right.floor(), self.image.width()) as usize;
        let rows =
            limit(top.ceil(), self.image.height()) as usize..=limit(bottom.floor(), self.image.height()) as usize;
        let looked_at = LOOKED_AT / area(&outer).max(LOOKED_AT);
        let limit = limit_of(looked_at);
        for y in rows {
            let line = self.image.row(y);
            for x in columns.clone() {
                if scatter(x as u32, y as u32) > limit {
                    continue;
                }
                let at = inverse.map(x as f64, y as f64);
                let is_inside = |of: f64| of > -outside && of < side + outside;
                let depth = at.x.min(at.y).min(side - at.x).min(side - at.y);
                if is_inside(at.x)
                    && is_inside(at.y)
                    && depth < inner
                    && self.pattern.has_edge(at, EDGE_REACH / module_px)
                {
                    self.pixels.push((x as f64, y as f64, f64::from(line[x])));
                }
            }
        }
        let compared = PIXELS / (self.pixels.len() as f64).max(PIXELS);
        let limit = limit_of(looked_at * compared);
        self.pixels.retain(|(x, y, _)| scatter(*x as u32, *y as u32) <= limit);
        (self.pixels.len() > 3 * PARAMETERS).then_some(())
    }

    /// Starts from `modules` and grey levels; `None` if the pattern does not come to rest near there.
    pub(crate) fn run(&self, modules: &Homography, black: f64, white: f64) -> Option<RefinedCorners> {
        let mut parameters = SVector::<f64, PARAMETERS>::zeros();
        for (index, value) in modules.0.transpose().iter().take(8).enumerate() {
            parameters[index] = value / modules.0[(2, 2)];
        }
        (parameters[BLACK], parameters[WHITE]) = (black, white);
        (parameters[BLUR], parameters[BLUR + 1]) = (USUAL_BLUR.ln(), USUAL_BLUR.ln());
        let start = self.corners_of(&parameters)?;
        let mut scale = (white - black) * 0.3;
        let mut every = if self.pixels.len() > COARSE * 100 { COARSE } else { 1 };
        let mut fit = self.evaluate(&parameters, scale, every)?;
        let mut damping = 1e-3;
        let mut doubt = FIRST_DOUBT;
        for _ in 0..MAX_ITERATIONS {
            let next = fit.step(damping, &self.bend(&fit.parameters)?, self.bend_bounds, doubt * fit.variance)?;
            let moved = largest_move(&self.corners_of(&fit.parameters)?, &self.corners_of(&next)?);
            if every == 1 && moved < CONVERGED && doubt <= 1.0 {
                fit.parameters = next;
                break;
            }
            let is_coarse_enough = every > 1 && moved < COARSE_CONVERGED && doubt <= 1.0;
            if moved < COARSE_CONVERGED {
                doubt = 1.0;
            }
            if is_coarse_enough {
                every = 1;
                scale = scale.min(self.deviation(&fit, COARSE));
            }
            let tried = self.evaluate(&next, scale, every)?;
            let variance = doubt * fit.variance;
            let is_worse = tried.cost_with_prior(variance) > fit.cost_with_prior(variance);
            if is_worse && !is_coarse_enough {
                damping = (damping * 10.0).max(1e-2);
                if damping > 1e4 {
                    break;
                }
                continue;
            }
            damping *= 0.1;
            fit = tried;
            // Outliers are what is far beyond the usual residual.
            let deviation = self.deviation(&fit, every);
            if every > 1 && deviation < 0.7 * scale {
                scale = deviation;
                fit = self.evaluate(&fit.parameters, scale, every)?;
            }
        }
        if every > 1 {
            fit = self.evaluate(&fit.parameters, scale, 1)?;
        }
        let corners = self.corners_of(&fit.parameters)?;
        let module = module_px(&corners);
        let shift = largest_move(&start, &corners);
        if shift.is_nan() || shift > MAX_SHIFT + MAX_SHIFT_MODULES * module {
            return None;
        }
        let variance = fit.cost / (self.pixels.len() - PARAMETERS) as f64;
        let inverse = fit.normal_with_prior(variance).cholesky()?.inverse() * variance;
        let jacobian = corner_jacobian(&fit.parameters, &self.bend(&fit.parameters)?);
        let covariance = jacobian * inverse.fixed_view::<SHAPE, SHAPE>(0, 0) * jacobian.transpose();
        Some(RefinedCorners { corners, covariance })
    }

    /// The standard deviation of the residuals of each `every`-th pixel, grey levels; at least one.
    fn deviation(&self, fit: &Fit, every: usize) -> f64 {
        (fit.cost * every as f64 / self.pixels.len() as f64).sqrt().max(1.0)
    }

    fn bend(&self, parameters: &SVector<f64, PARAMETERS>) -> Option<Bend> {
        Bend::new(self.axis, self.middle, parameters[BEND])
    }

    fn corners_of(&self, parameters: &SVector<f64, PARAMETERS>) -> Option<[Point2<f64>; 4]> {
        let bend = self.bend(parameters)?;
        Some(straight_corners(parameters).map(|corner| bend.bend(corner).0))
    }

    /// The normal equations at `parameters`; residuals beyond some `scale` count less.
    fn evaluate(&self, parameters: &SVector<f64, PARAMETERS>, scale: f64, every: usize) -> Option<Fit> {
        let [h0, h1, h2, h3, h4, h5, h6, h7] = std::array::from_fn(|index| parameters[index]);
        let forward = Homography(nalgebra::Matrix3::new(h0, h1, h2, h3, h4, h5, h6, h7, 1.0));
        let inverse = forward.inverse()?;
        let bend = self.bend(parameters)?;
        let (black, white) = (parameters[BLACK], parameters[WHITE]);
        let blur = [parameters[BLUR].exp(), parameters[BLUR + 1].exp()];
        let contrast = white - black;
        // Arrays in rows, which are faster to add to than matrices in columns.
        let mut normal = [[0.0; PARAMETERS]; PARAMETERS];
        let mut right = [0.0; PARAMETERS];
        let (mut cost, mut count) = (0.0, 0.0);
        for (x, y, grey) in self.pixels.iter().step_by(every) {
            let (straight, by_k1) = bend.straighten(*x, *y);
            let (x, y) = (straight.x, straight.y);
            let at = inverse.map(x, y);
            let (u, v) = (at.x, at.y);
            // The derivatives of the pixel by u and v.
            let scale_w = 1.0 / (h6 * u + h7 * v + 1.0);
            let (xu, xv) = ((h0 - x * h6) * scale_w, (h1 - x * h7) * scale_w);
            let (yu, yv) = ((h3 - y * h6) * scale_w, (h4 - y * h7) * scale_w);
            let modules_per_area = 1.0 / (xu * yv - xv * yu);
            // An edge of constant u runs along v, and the other way round.
            let blur_u = blur[0] * (xv * xv + yv * yv).sqrt() * modules_per_area.abs();
            let blur_v = blur[1] * (xu * xu + yu * yu).sqrt() * modules_per_area.abs();
            let Some(level) = self.pattern.level(at, [blur_u, blur_v]) else { continue };
            let residual = grey - (black + contrast * level.value);
            let weight = (HUBER * scale / residual.abs()).min(1.0);
            // Where the picture moves by (dx, dy), the pattern under a pixel moves the other way.
            let by_pixel = -contrast * modules_per_area * scale_w;
            let by_x = by_pixel * (level.by_u * yv - level.by_v * yu);
            let by_y = by_pixel * (level.by_v * xu - level.by_u * xv);
            let by_w = -(by_x * x + by_y * y);
            let row = [
                by_x * u,
                by_x * v,
                by_x,
                by_y * u,
                by_y * v,
                by_y,
                by_w * u,
                by_w * v,
                -(by_x * by_k1.x + by_y * by_k1.y),
                1.0 - level.value,
                level.value,
                contrast * level.by_log_blur[0],
                contrast * level.by_log_blur[1],
            ];
            for ((line, right), of) in normal.iter_mut().zip(&mut right).zip(&row) {
                let weighted = weight * of;
                *right += weighted * residual;
                for (sum, other) in line.iter_mut().zip(&row) {
                    *sum += weighted * other;
                }
            }
            cost += weight * residual * residual;
            count += 1.0;
        }
        // An unseen blur stays as it is.
        for index in [BLUR, BLUR + 1] {
            normal[index][index] += contrast.powi(2) * 1e-3;
        }
        let normal = SMatrix::from(normal);
        let right = SVector::from(right);
        let variance = (cost / f64::max(count, 1.0)).max(1.0);
        Some(Fit { parameters: *parameters, normal, right, cost, variance })
    }
}

/// A number for each pixel, without a pattern: a regular choice of pixels would have them all at the same distances from the edges of a
/// tag that lies along it.
const fn scatter(x: u32, y: u32) -> u32 {
    let mixed = x.wrapping_mul(0x9E37_79B9) ^ y.wrapping_mul(0x85EB_CA6B);
    let mixed = (mixed ^ mixed >> 15).wrapping_mul(0x2C1B_3C6D);
    mixed ^ mixed >> 16
}

/// Below this number is such a share of all pixels.
fn limit_of(share: f64) -> u32 {
    (share * f64::from(u32::MAX)) as u32
}

/// Before the lens bends them.
fn straight_corners(parameters: &SVector<f64, PARAMETERS>) -> [Point2<f64>; 4] {
    let side = SIDE as f64;
    [(0.0, 0.0), (side, 0.0), (side, side), (0.0, side)].map(|(u, v)| {
        let w = parameters[6] * u + parameters[7] * v + 1.0;
        Point2::new(
            (parameters[0] * u + parameters[1] * v + parameters[2]) / w,
            (parameters[3] * u + parameters[4] * v + parameters[5]) / w,
        )
    })
}

/// Derivatives of the corners by the parameters of the perspective and the bend.
fn corner_jacobian(parameters: &SVector<f64, PARAMETERS>, bend: &Bend) -> SMatrix<f64, 8, SHAPE> {
    let side = SIDE as f64;
    let mut jacobian = SMatrix::<f64, 8, SHAPE>::zeros();
    let corners = straight_corners(parameters);
    for (corner, (u, v)) in [(0.0, 0.0), (side, 0.0), (side, side), (0.0, side)].into_iter().enumerate() {
        let w = parameters[6] * u + parameters[7] * v + 1.0;
        let (x, y) = (corners[corner].x, corners[corner].y);
        let mut straight = SMatrix::<f64, 2, SHAPE>::zeros();
        for (column, value) in [u, v, 1.0].into_iter().enumerate() {
            straight[(0, column)] = value / w;
            straight[(1, column + 3)] = value / w;
        }
        for (column, value) in [u, v].into_iter().enumerate() {
            straight.set_column(column + 6, &(Vector2::new(-x, -y) * (value / w)));
        }
        let (pixel, by_straight) = bend.bend(corners[corner]);
        // The point that stays at this pixel moves the other way.
        straight.set_column(BEND, &-bend.straighten(pixel.x, pixel.y).1);
        jacobian.fixed_rows_mut::<2>(2 * corner).copy_from(&(by_straight * straight));
    }
    jacobian
}

fn largest_move(before: &[Point2<f64>; 4], after: &[Point2<f64>; 4]) -> f64 {
    before.iter().zip(after).map(|(one, other)| (other - one).norm()).fold(0.0, f64::max)
}

/// Pixels per module, along the longest side.
fn module_px(corners: &[Point2<f64>; 4]) -> f64 {
    let sides = (0..4).map(|side| (corners[(side + 1) % 4] - corners[side]).norm());
    sides.fold(0.0, f64::max) / SIDE as f64
}
