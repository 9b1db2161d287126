//! Pictures with a tag, as PGM: no encoder stands between the drawing and the search.

use posebridge_vision::tag36h11_modules;

/// Width of a module, px.
const MODULE: usize = 6;
/// Modules of the black rim's side.
const SIDE: usize = 8;

/// A light picture with tag `id`, whose upper left corner is that of the pixel (`left`, `top`).
pub(crate) fn picture_with_tag((width, height): (usize, usize), id: u16, (left, top): (usize, usize)) -> Vec<u8> {
    // With the white around it.
    let modules = tag36h11_modules(id).expect("the family has it");
    let mut pixels = vec![200_u8; width * height];
    for row in 0..SIDE * MODULE {
        for column in 0..SIDE * MODULE {
            if !modules[1 + row / MODULE][1 + column / MODULE] {
                pixels[(top + row) * width + left + column] = 30;
            }
        }
    }
    pgm((width, height), &pixels)
}

pub(crate) fn empty_picture(size: (usize, usize)) -> Vec<u8> {
    pgm(size, &vec![200; size.0 * size.1])
}

/// The corners of the black rim; the centre of the first pixel is at 0, 0.
pub(crate) fn corners((left, top): (usize, usize)) -> [[f64; 2]; 4] {
    let (left, top) = (left as f64 - 0.5, top as f64 - 0.5);
    let side = (SIDE * MODULE) as f64;
    [[left, top], [left + side, top], [left + side, top + side], [left, top + side]]
}

fn pgm((width, height): (usize, usize), pixels: &[u8]) -> Vec<u8> {
    [format!("P5 {width} {height} 255\n").as_bytes(), pixels].concat()
}
