//! Which tag a quadrilateral is: its modules, against the brightness of its black rim and of the white around it.

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

use crate::grey_image::GreyImage;
use crate::homography::Homography;
use crate::tag36h11::{AROUND, BITS, RecognisedTag, SIDE, recognise, ring};

/// Least difference between white and black, grey levels.
const MIN_CONTRAST: f64 = 12.0;
/// Most modules of the rim that may look white; those of a quadrilateral whose corners are not exact do.
const MAX_RIM_ERRORS: usize = 8;
/// Standard deviation of the blur that is taken off before bits are read, px, and in how many steps.
const USUAL_BLUR: f64 = 0.75;
const SHARPENING_STEPS: usize = 5;

/// What a quadrilateral holds: a rim that may be a tag's, and the tag if its bits are one.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DecodedSquare {
    pub(crate) tag: Option<RecognisedTag>,
    /// Mean distance of the bits from the level between black and white, grey levels.
    pub(crate) margin: f64,
    /// Grey levels.
    pub(crate) black: f64,
    pub(crate) white: f64,
}

/// `modules` maps the tag's modules to pixels, with (0, 0) at a corner of the rim.
pub(crate) fn decode(image: GreyImage<'_>, modules: &Homography) -> Option<DecodedSquare> {
    let mut seen = [[0.0; AROUND]; AROUND];
    for (row, line) in seen.iter_mut().enumerate() {
        for (column, grey) in line.iter_mut().enumerate() {
            let at = modules.map(column as f64 - 0.5, row as f64 - 0.5);
            *grey = image.sample(at.x, at.y);
        }
    }
    let (mut black, mut white) = (GreyPlane::default(), GreyPlane::default());
    for_each_module(|row, column, ring| match ring {
        0 => white.add(row, column, seen[row][column]),
        1 => black.add(row, column, seen[row][column]),
        _ => {}
    });
    let (black, white) = (black.fit()?, white.fit()?);
    let middle = (AROUND as f64 - 1.0) / 2.0;
    let centre = Vector3::new(middle, middle, 1.0);
    let (black_level, white_level) = (black.dot(&centre), white.dot(&centre));
    if white_level - black_level < MIN_CONTRAST {
        return None;
    }
    let sharp = sharpen(&seen, &blur_shares(modules)?);
    let above = |row: usize, column: usize| {
        let at = Vector3::new(column as f64, row as f64, 1.0);
        sharp[row][column] - f64::midpoint(black.dot(&at), white.dot(&at))
    };
    let mut rim_errors = 0;
    for_each_module(|row, column, ring| {
        if ring == 1 && above(row, column) > 0.0 {
            rim_errors += 1;
        }
    });
    if rim_errors > MAX_RIM_ERRORS {
        return None;
    }
    let (mut bits, mut margin) = (0, 0.0);
    for row in 2..BITS + 2 {
        for column in 2..BITS + 2 {
            let distance = above(row, column);
            bits = bits << 1 | u64::from(distance > 0.0);
            margin += distance.abs();
        }
    }
    Some(DecodedSquare {
        tag: recognise(bits),
        margin: margin / (BITS * BITS) as f64,
        black: black_level,
        white: white_level,
    })
}

/// How much of a module each of the nine around its place is seen there: in a view from the side the blur of the picture lies across
/// modules.
fn blur_shares(modules: &Homography) -> Option<[[f64; 3]; 3]> {
    let middle = SIDE as f64 / 2.0;
    let at = |u: f64, v: f64| modules.map(middle + u, middle + v);
    let (right, down) = (at(0.5, 0.0) - at(-0.5, 0.0), at(0.0, 0.5) - at(0.0, -0.5));
    let to_modules = Matrix2::from_columns(&[right, down]).try_inverse()?;
    // A module has the variance of a uniform distribution.
    let spread = to_modules * to_modules.transpose() * USUAL_BLUR.powi(2) + Matrix2::identity() / 12.0;
    let precision = spread.try_inverse()?;
    let weight = |row: usize, column: usize| {
        let offset = Vector2::new(column as f64 - 1.0, row as f64 - 1.0);
        (-0.5 * offset.dot(&(precision * offset))).exp()
    };
    let weights: [[f64; 3]; 3] = std::array::from_fn(|row| std::array::from_fn(|column| weight(row, column)));
    let sum: f64 = weights.as_flattened().iter().sum();
    Some(weights.map(|line| line.map(|weight| weight / sum)))
}

/// Takes the blur off all but the outermost modules (Van Cittert): what a blurred guess differs from what was seen is added to it.
fn sharpen(seen: &[[f64; AROUND]; AROUND], shares: &[[f64; 3]; 3]) -> [[f64; AROUND]; AROUND] {
    let mut sharp = *seen;
    for _ in 0..SHARPENING_STEPS {
        let guess = sharp;
        for row in 1..AROUND - 1 {
            for column in 1..AROUND - 1 {
                let mut blurred = 0.0;
                for (line, shares) in guess[row - 1..].iter().zip(shares) {
                    blurred += line[column - 1..].iter().zip(shares).map(|(grey, share)| grey * share).sum::<f64>();
                }
                sharp[row][column] += seen[row][column] - blurred;
            }
        }
    }
    sharp
}

/// Passes row, column and distance from the outside of each module.
fn for_each_module(mut take: impl FnMut(usize, usize, usize)) {
    for row in 0..AROUND {
        for column in 0..AROUND {
            take(row, column, ring(row, column));
        }
    }
}

/// Brightness over a tag, as a plane: light does not fall on all of it alike.
#[derive(Default)]
struct GreyPlane {
    squares: Matrix3<f64>,
    products: Vector3<f64>,
}

impl GreyPlane {
    fn add(&mut self, row: usize, column: usize, grey: f64) {
        let at = Vector3::new(column as f64, row as f64, 1.0);
        self.squares += at * at.transpose();
        self.products += at * grey;
    }

    /// Change per column, per row, and the value at the first of each.
    fn fit(&self) -> Option<Vector3<f64>> {
        Some(self.squares.cholesky()?.solve(&self.products))
    }
}
