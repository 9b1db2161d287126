//! The outlines of dark areas: closed lines between dark and bright pixels, clockwise around dark ones.

use nalgebra::Point2;

use crate::threshold::{DARK, DarkPixels};

/// A bit of [`DarkPixels`]: an outline ran up along the pixel's left edge.
const FOLLOWED: u8 = 2;

/// One outline.
#[derive(Default)]
pub(crate) struct Outline {
    /// The middles of the pixel edges that it runs along, in half pixels; the centre of the first pixel is (0, 0).
    pub(crate) points: Vec<(i32, i32)>,
    /// Twice the area that it encloses, px²; negative around bright pixels.
    pub(crate) double_area: i64,
}

impl Outline {
    pub(crate) fn point(&self, index: usize) -> Point2<f64> {
        let (x, y) = self.points[index];
        Point2::new(f64::from(x) / 2.0, f64::from(y) / 2.0)
    }

    /// Least and largest x, and y, of the points.
    pub(crate) fn bounds(&self) -> [i32; 4] {
        self.points.iter().fold([i32::MAX, i32::MIN, i32::MAX, i32::MIN], |[left, right, top, bottom], (x, y)| {
            [left.min(*x), right.max(*x), top.min(*y), bottom.max(*y)]
        })
    }
}

/// Passes each outline of at least `min_points` points to `take`.
pub(crate) fn for_each_outline(
    dark: &mut DarkPixels,
    outline: &mut Outline,
    min_points: usize,
    mut take: impl FnMut(&Outline),
) {
    let width = dark.width;
    for y in 1..dark.height.saturating_sub(1) {
        let mut x = 1;
        while let Some(next) = next_start(&dark.bytes[y * width..(y + 1) * width], x) {
            follow(dark, next, y, outline);
            if outline.points.len() >= min_points {
                take(outline);
            }
            x = next + 1;
        }
    }
}

/// Bytes that are looked at together.
const WORD: usize = 8;
const EACH_DARK: u64 = u64::from_ne_bytes([DARK; WORD]);

/// The next dark pixel right of a bright one whose left edge no outline has passed.
fn next_start(row: &[u8], mut from: usize) -> Option<usize> {
    let word = |at: usize| row.get(at..at + WORD)?.try_into().ok().map(u64::from_ne_bytes);
    while let (Some(before), Some(at)) = (word(from - 1), word(from)) {
        if at & !(at >> 1) & !before & EACH_DARK != 0 {
            break;
        }
        from += WORD;
    }
    let pairs = row.get(from - 1..)?.windows(2);
    let found = pairs.enumerate().find(|(_, pair)| pair[0] & DARK == 0 && pair[1] == DARK);
    found.map(|(index, _)| from + index)
}

const UP: usize = 3;

/// Follows the outline that runs up along the left edge of the pixel, with dark pixels on its right. Dark pixels that touch at a
/// corner belong together.
fn follow(dark: &mut DarkPixels, x: usize, y: usize, outline: &mut Outline) {
    let width = dark.width;
    // Right, down, left, up. Corner (x, y) is the upper left one of pixel (x, y), and has its number.
    let steps = [1, width.cast_signed(), -1, -width.cast_signed()];
    // The pixels ahead, left and right of the way: so far before that of the corner.
    let ahead = [[width, 0], [0, 1], [1, width + 1], [width + 1, width]];
    let start = (y + 1) * width + x;
    let (mut corner, mut direction) = (start, UP);
    // The middle of the next edge, in half pixels.
    let mut point = (2 * (x as i32 - 1) - 1, 2 * (y as i32 - 1));
    outline.points.clear();
    let mut area = 0;
    loop {
        outline.points.push(point);
        corner = corner.wrapping_add_signed(steps[direction]);
        match direction {
            1 => area += i64::from(point.0),
            UP => {
                area -= i64::from(point.0);
                dark.bytes[corner] |= FOLLOWED;
            }
            _ => {}
        }
        let [left, right] = ahead[direction].map(|before| dark.bytes[corner - before] & DARK != 0);
        let next = match (left, right) {
            (true, _) => (direction + 3) % 4,
            (false, true) => direction,
            (false, false) => (direction + 1) % 4,
        };
        if corner == start && next == UP {
            break;
        }
        // Half an edge on in the old direction, half in the new.
        for half in [direction, next] {
            let (dx, dy) = HALF_STEPS[half];
            point = (point.0 + dx, point.1 + dy);
        }
        direction = next;
    }
    outline.double_area = area;
}

/// Right, down, left, up.
const HALF_STEPS: [(i32, i32); 4] = [(1, 0), (0, 1), (-1, 0), (0, -1)];
