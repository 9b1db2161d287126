//! Which pixels of a picture are dark: darker than the middle between the darkest and the brightest pixel around.
//!
//! Where these differ by no more than noise makes them differ, nothing is dark: flat areas have no outline. A noisy picture is
//! smoothed first. Where they differ by much more, pixels are sharpened: the rim of a tag that is seen from the side may be thinner than
//! a pixel, and the lens has mixed it with the white around it.

use crate::grey_image::GreyImage;

/// Side of the tiles whose extremes are compared, px; those of a tile and its neighbours decide.
const TILE: usize = 4;
/// Least difference between dark and bright: grey levels, and standard deviations of the noise. Of the 144 pixels of nine tiles the
/// extremes of noise alone are about five and a half apart.
const MIN_CONTRAST: f64 = 20.0;
const MIN_CONTRAST_DEVIATIONS: f64 = 7.5;
/// What is left of the noise of a picture that was smoothed.
const SMOOTHED_NOISE: f64 = 0.375;
/// What sharpening makes of noise: the root of 2² and four times ¼².
const SHARPENED_NOISE: f64 = 2.062;
/// A picture whose noise has a larger standard deviation is smoothed, grey levels.
const MAX_NOISE: f64 = 4.5;
/// Of so many rows one is looked at for the noise.
const NOISE_ROWS: usize = 16;

/// A bit of [`DarkPixels`]: the pixel is dark.
pub(crate) const DARK: u8 = 1;

/// A byte for each pixel, with one row and column of bright ones around the picture.
#[derive(Default)]
pub(crate) struct DarkPixels {
    pub(crate) bytes: Vec<u8>,
    /// With the columns around.
    pub(crate) width: usize,
    pub(crate) height: usize,
    smoothed: Vec<u8>,
    /// Extremes of the tiles, row by row.
    extremes: [Vec<u8>; 2],
    rows: [Vec<u8>; 2],
    spread: [Vec<u8>; 2],
}

impl DarkPixels {
    pub(crate) fn find(&mut self, image: GreyImage<'_>) {
        let (width, height) = (image.width(), image.height());
        (self.width, self.height) = (width + 2, height + 2);
        self.bytes.clear();
        self.bytes.resize(self.width * self.height, 0);
        if width < 2 * TILE || height < 2 * TILE {
            return;
        }
        let noise = noise(image);
        let contrast = |noise: f64| MIN_CONTRAST.max(MIN_CONTRAST_DEVIATIONS * noise).min(255.0) as u8;
        if noise > MAX_NOISE {
            let mut smoothed = std::mem::take(&mut self.smoothed);
            smooth(image, &mut smoothed);
            if let Some(smooth) = GreyImage::new(&smoothed, width, height, width) {
                self.compare(smooth, contrast(SMOOTHED_NOISE * noise));
            }
            self.smoothed = smoothed;
        } else {
            self.compare(image, contrast(noise));
        }
    }

    fn compare(&mut self, image: GreyImage<'_>, min_contrast: u8) {
        self.find_extremes(image);
        let columns = image.width().div_ceil(TILE);
        let rows = image.height().div_ceil(TILE);
        let mut limits = Limits { quarters: vec![0; columns * TILE], sharpened: vec![0; columns * TILE] };
        for tile_row in 0..rows {
            self.limits_of_tiles(tile_row, rows, columns, min_contrast, &mut limits);
            for y in tile_row * TILE..((tile_row + 1) * TILE).min(image.height()) {
                let from = (y + 1) * self.width + 1;
                find_dark(image, y, &limits, &mut self.bytes[from..from + image.width()]);
            }
        }
    }

    /// The smallest and the largest pixel of each tile.
    fn find_extremes(&mut self, image: GreyImage<'_>) {
        let columns = image.width().div_ceil(TILE);
        let [least, most] = &mut self.extremes;
        least.clear();
        most.clear();
        let [low, high] = &mut self.rows;
        for top in (0..image.height()).step_by(TILE) {
            for row in [&mut *low, &mut *high] {
                row.clear();
                row.extend_from_slice(image.row(top));
            }
            for y in top + 1..(top + TILE).min(image.height()) {
                for ((low, high), grey) in low.iter_mut().zip(&mut *high).zip(image.row(y)) {
                    *low = (*low).min(*grey);
                    *high = (*high).max(*grey);
                }
            }
            least.extend(low.chunks(TILE).map(|tile| tile.iter().copied().min().unwrap_or(0)));
            most.extend(high.chunks(TILE).map(|tile| tile.iter().copied().max().unwrap_or(0)));
            debug_assert_eq!(least.len() % columns, 0);
        }
    }

    /// Writes below which grey level each pixel of a row of tiles is dark.
    fn limits_of_tiles(&mut self, row: usize, rows: usize, columns: usize, min_contrast: u8, limits: &mut Limits) {
        let around = row.saturating_sub(1)..(row + 2).min(rows);
        let [least, most] = &mut self.spread;
        let column = |of: &[u8], row: usize| of[row * columns..(row + 1) * columns].to_vec();
        *least = column(&self.extremes[0], row);
        *most = column(&self.extremes[1], row);
        for row in around {
            let from = row * columns;
            for (one, other) in least.iter_mut().zip(&self.extremes[0][from..from + columns]) {
                *one = (*one).min(*other);
            }
            for (one, other) in most.iter_mut().zip(&self.extremes[1][from..from + columns]) {
                *one = (*one).max(*other);
            }
        }
        let sharpened_contrast = SHARPENED_NOISE * f64::from(min_contrast);
        for column in 0..columns {
            let near = column.saturating_sub(1)..(column + 2).min(columns);
            let low = least[near.clone()].iter().copied().min().unwrap_or(0);
            let high = most[near].iter().copied().max().unwrap_or(0);
            let limit = if high - low < min_contrast { 0 } else { low + (high - low) / 2 };
            let pixels = column * TILE..(column + 1) * TILE;
            limits.quarters[pixels.clone()].fill(4 * i16::from(limit));
            limits.sharpened[pixels].fill(i16::from(f64::from(high - low) >= sharpened_contrast));
        }
    }
}

/// For each pixel of a row.
struct Limits {
    /// Four times the grey level below which it is dark.
    quarters: Vec<i16>,
    /// 1 where it is sharpened before, else 0.
    sharpened: Vec<i16>,
}

/// Finds the dark pixels of a row. Sharpening adds what a pixel differs from the mean of its four neighbours: to first order, that takes
/// off a blur with a variance of half a pixel², about that of a lens in focus. The outermost pixels stay as they are.
fn find_dark(image: GreyImage<'_>, y: usize, limits: &Limits, dark: &mut [u8]) {
    let row = image.row(y);
    let (above, below) = (image.row(y.saturating_sub(1)), image.row((y + 1).min(image.height() - 1)));
    let (last, inner) = (row.len() - 1, 1..row.len() - 1);
    for at in [0, last] {
        dark[at] = u8::from(4 * i16::from(row[at]) < limits.quarters[at]);
    }
    let neighbours = row.windows(3).zip(&above[inner.clone()]).zip(&below[inner.clone()]);
    let limits = limits.quarters[inner.clone()].iter().zip(&limits.sharpened[inner.clone()]);
    for ((dark, ((three, above), below)), (limit, sharpened)) in dark[inner].iter_mut().zip(neighbours).zip(limits) {
        let [left, at, right] = [three[0], three[1], three[2]].map(i16::from);
        let around = left + right + i16::from(*above) + i16::from(*below);
        *dark = u8::from(4 * at + sharpened * (4 * at - around) < *limit);
    }
}

/// The standard deviation of a picture's noise, from the median of second differences: edges are few and do not move it.
fn noise(image: GreyImage<'_>) -> f64 {
    let mut counts = [0_u32; 1021];
    for y in (0..image.height()).step_by(NOISE_ROWS) {
        for three in image.row(y).windows(3) {
            let [before, at, after] = [three[0], three[1], three[2]].map(i32::from);
            counts[(before - 2 * at + after).unsigned_abs() as usize] += 1;
        }
    }
    let half = counts.iter().sum::<u32>() / 2;
    let mut below = 0;
    let median = counts.iter().position(|count| {
        below += count;
        below >= half
    });
    // The median of |x| is 0.674 standard deviations; a second difference has √6 that of a pixel.
    median.unwrap_or(0) as f64 / (0.674_490 * 6_f64.sqrt())
}

/// Weights 1, 2, 1 both ways; the outermost pixels stay as they are.
fn smooth(image: GreyImage<'_>, smoothed: &mut Vec<u8>) {
    smoothed.clear();
    let mut sums = vec![0_u16; image.width()];
    for y in 0..image.height() {
        let row = image.row(y);
        let (above, below) = (image.row(y.saturating_sub(1)), image.row((y + 1).min(image.height() - 1)));
        for (((sum, above), at), below) in sums.iter_mut().zip(above).zip(row).zip(below) {
            *sum = u16::from(*above) + 2 * u16::from(*at) + u16::from(*below);
        }
        smoothed.push(row[0]);
        smoothed.extend(sums.windows(3).map(|three| ((three[0] + 2 * three[1] + three[2] + 8) / 16) as u8));
        smoothed.push(row[row.len() - 1]);
    }
}
