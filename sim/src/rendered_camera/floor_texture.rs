//! What the floor looks like: planks with grain, the gaps between them, and stains.

use crate::random::RandomStream;

/// Brightness of the floor, white paper being 1.
const MEAN: f64 = 0.42;
const PLANK_TONE: f64 = 0.06;
const GRAIN: f64 = 0.035;
const GAP: f64 = 0.16;
/// Of a plank, and half the width of the gap beside it, m.
const PLANK_WIDTH_M: f64 = 0.13;
const PLANK_LENGTH_M: f64 = 1.4;
const HALF_GAP_M: f64 = 0.003;
/// Along and across a plank, m.
const GRAIN_SIZE_M: [f64; 2] = [0.12, 0.007];
const STAINS: usize = 80;
/// Stains lie this far from the arena's origin at most, along x and y, m.
const STAINED_M: f64 = 3.0;
/// Beyond the horizon.
const FAR: f32 = 0.55;

/// A seeded floor of planks along x.
#[derive(Clone, Debug)]
pub(crate) struct FloorTexture {
    seed: u64,
    stains: Vec<Stain>,
}

#[derive(Clone, Copy, Debug)]
struct Stain {
    x_m: f64,
    y_m: f64,
    radius_m: f64,
    darkness: f64,
}

impl FloorTexture {
    pub(crate) fn new(seed: u64) -> Self {
        let mut stream = RandomStream::new(seed, "camera floor");
        let stain = |_| Stain {
            x_m: stream.uniform(-STAINED_M, STAINED_M),
            y_m: stream.uniform(-STAINED_M, STAINED_M),
            radius_m: stream.uniform(0.02, 0.2),
            darkness: stream.uniform(-0.15, 0.4),
        };
        let stains = (0..STAINS).map(stain).collect();
        Self { seed, stains }
    }

    /// Brightness at a point of the floor, white paper being 1; of the distance where a coordinate is not a number.
    pub(crate) fn brightness(&self, point_m: [f32; 2]) -> f32 {
        let [x_m, y_m] = point_m.map(f64::from);
        if x_m.is_nan() || y_m.is_nan() {
            return FAR;
        }
        let row = (y_m / PLANK_WIDTH_M).floor();
        let along = x_m / PLANK_LENGTH_M + self.hash(row as i64, -1);
        let plank = along.floor();
        let across = y_m / PLANK_WIDTH_M - row;
        let end_m = PLANK_LENGTH_M * (along - plank).min(1.0 - along + plank);
        let from_gap_m = end_m.min(PLANK_WIDTH_M * across.min(1.0 - across));
        let plank_share = (from_gap_m / HALF_GAP_M).min(1.0);
        let tone = PLANK_TONE * (2.0 * self.hash(row as i64, plank as i64) - 1.0);
        let grain = GRAIN * (2.0 * self.smooth_hash(x_m / GRAIN_SIZE_M[0] + 977.0 * row, y_m / GRAIN_SIZE_M[1]) - 1.0);
        let stains: f64 = self.stains.iter().map(|stain| stain.darkness_at(x_m, y_m)).sum();
        let plank = (MEAN + tone + grain) * (1.0 - stains.min(0.8));
        (GAP + plank_share * (plank - GAP)) as f32
    }

    /// A number in [0, 1) for each point of a lattice.
    fn hash(&self, column: i64, row: i64) -> f64 {
        // The finaliser of SplitMix64 (Steele, Lea and Flood, 2014).
        let mut bits = self.seed ^ (column as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        bits ^= (row as u64).wrapping_mul(0xd1b5_4a32_d192_ed03).rotate_left(31);
        bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((bits ^ (bits >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// Interpolated between the points of the lattice.
    fn smooth_hash(&self, column: f64, row: f64) -> f64 {
        let (left, upper) = (column.floor(), row.floor());
        let (across, down) = (column - left, row - upper);
        let mix = |one: f64, other: f64, share: f64| one + share * (other - one);
        let at = |right: i64, below: i64| self.hash(left as i64 + right, upper as i64 + below);
        mix(mix(at(0, 0), at(1, 0), across), mix(at(0, 1), at(1, 1), across), down)
    }
}

impl Stain {
    fn darkness_at(&self, x_m: f64, y_m: f64) -> f64 {
        let distance = ((x_m - self.x_m).powi(2) + (y_m - self.y_m).powi(2)) / self.radius_m.powi(2);
        self.darkness * (1.0 - distance).max(0.0)
    }
}
