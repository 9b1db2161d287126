//! The noise of an image sensor, from a table of normal numbers.

use crate::random::RandomStream;

/// Normal numbers that each row begins anywhere in.
const TABLE: usize = 1 << 16;

/// Adds noise to the signal of pixels and rounds it to bytes.
///
/// Each row of each frame takes a run of the table from a random place on. Two rows of 640 pixels share numbers in one of fifty cases,
/// and then at different columns: a tag covers some dozens of rows, so that its corners see independent noise. From frame to frame no
/// pixel keeps its own.
#[derive(Clone, Debug)]
pub(crate) struct SensorNoise {
    seed: u64,
    table: Vec<f32>,
    width: usize,
    read_variance: f32,
    variance_per_level: f32,
    /// Where each row of the present frame begins in the table.
    starts: Vec<usize>,
}

impl SensorNoise {
    pub(crate) fn new(seed: u64, width: usize, read_noise: f64, shot_noise: f64) -> Self {
        let mut stream = RandomStream::new(seed, "camera noise");
        let table = (0..TABLE + width).map(|_| stream.normal() as f32).collect();
        let read_variance = read_noise.powi(2) as f32;
        Self { seed, table, width, read_variance, variance_per_level: shot_noise as f32, starts: Vec::new() }
    }

    pub(crate) fn begin_frame(&mut self, number: u64, height: usize) {
        let mut stream = RandomStream::new(self.seed, &format!("camera noise {number}"));
        self.starts.clear();
        self.starts.extend((0..height).map(|_| stream.uniform(0.0, TABLE as f64) as usize));
    }

    /// Writes the pixels from `left` on in a row of the present frame; `signal` is theirs.
    pub(crate) fn expose(&self, row: usize, left: usize, signal: &[f32], pixels: &mut [u8]) {
        let noise = &self.table[self.starts[row] + left..self.starts[row] + self.width];
        for ((pixel, level), noise) in pixels.iter_mut().zip(signal).zip(noise) {
            let sigma = (self.read_variance + self.variance_per_level * level).sqrt();
            // The cast cuts off at 0 and 255.
            *pixel = (level + noise * sigma + 0.5) as u8;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_variance_rises_with_the_level_and_frames_differ() {
        let mut noise = SensorNoise::new(5, 1_000, 2.0, 0.05);
        let mut frame = |number, level: f32| {
            noise.begin_frame(number, 100);
            let mut pixels = vec![0; 100_000];
            for (row, pixels) in pixels.chunks_mut(1_000).enumerate() {
                noise.expose(row, 0, &[level; 1_000], pixels);
            }
            pixels
        };
        for (level, variance) in [(40.0, 6.0), (200.0, 14.0)] {
            let pixels = frame(0, level);
            let mean = pixels.iter().map(|pixel| f64::from(*pixel)).sum::<f64>() / 1e5;
            let found = pixels.iter().map(|pixel| (f64::from(*pixel) - mean).powi(2)).sum::<f64>() / 1e5;
            assert!((mean - f64::from(level)).abs() < 0.05, "{mean}");
            // Rounding adds a twelfth.
            assert!((found / (variance + 1.0 / 12.0) - 1.0).abs() < 0.03, "{found}");
        }
        assert_eq!(frame(3, 100.0), frame(3, 100.0));
        let (one, other) = (frame(3, 100.0), frame(4, 100.0));
        let products = one.iter().zip(&other).map(|(a, b)| (f64::from(*a) - 100.0) * (f64::from(*b) - 100.0));
        let correlation = products.sum::<f64>() / 1e5 / 9.0;
        assert!(correlation.abs() < 0.02, "{correlation}");
    }
}
