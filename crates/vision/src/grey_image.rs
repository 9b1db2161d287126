//! A grey picture that somebody else holds.

/// Rows from the top, pixels from the left; the centre of the first pixel is (0, 0).
#[derive(Clone, Copy)]
pub struct GreyImage<'a> {
    pixels: &'a [u8],
    width: usize,
    height: usize,
    stride: usize,
}

/// A part of a picture, px.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ImageWindow {
    pub left: usize,
    pub top: usize,
    pub width: usize,
    pub height: usize,
}

impl<'a> GreyImage<'a> {
    /// `stride` is the distance between the beginnings of two rows. `None` if `pixels` are too few.
    pub fn new(pixels: &'a [u8], width: usize, height: usize, stride: usize) -> Option<Self> {
        let needed = match height {
            0 => 0,
            rows => stride.checked_mul(rows - 1)?.checked_add(width)?,
        };
        (stride >= width && pixels.len() >= needed).then_some(Self { pixels, width, height, stride })
    }

    pub const fn width(&self) -> usize {
        self.width
    }

    pub const fn height(&self) -> usize {
        self.height
    }

    /// Empty below the last row.
    pub fn row(&self, y: usize) -> &'a [u8] {
        if y >= self.height {
            return &[];
        }
        self.pixels.get(y * self.stride..).and_then(|rest| rest.get(..self.width)).unwrap_or_default()
    }

    /// The part from (`left`, `top`) on, cut at the picture's edges.
    pub fn window(&self, left: usize, top: usize, width: usize, height: usize) -> Self {
        let (left, top) = (left.min(self.width), top.min(self.height));
        let pixels = self.pixels.get(top * self.stride + left..).unwrap_or_default();
        Self { pixels, width: width.min(self.width - left), height: height.min(self.height - top), stride: self.stride }
    }

    /// Interpolated between the four nearest pixels; beyond the picture, its edge goes on.
    pub fn sample(&self, x: f64, y: f64) -> f64 {
        let (x, y) = (x.clamp(0.0, self.width as f64 - 1.0), y.clamp(0.0, self.height as f64 - 1.0));
        let (left, top) = (x as usize, y as usize);
        let (upper, lower) = (self.row(top), self.row((top + 1).min(self.height - 1)));
        let right = (left + 1).min(self.width - 1);
        let (across, down) = (x - left as f64, y - top as f64);
        let mix = |row: &[u8]| {
            let (one, other) = (f64::from(row[left]), f64::from(row[right]));
            one + across * (other - one)
        };
        let (above, below) = (mix(upper), mix(lower));
        above + down * (below - above)
    }
}
