//! The tags of the family tag36h11: 587 squares of 8 x 8 modules, with a black rim around 36 bits.
//!
//! Any two differ in at least 11 bits, whichever way they are turned. The codes are those of AprilTag (Olson, ICRA 2011).

/// Modules of a side, with the rim.
pub(crate) const SIDE: usize = 8;
/// Modules of a side, with the rim and the white around.
pub(crate) const AROUND: usize = SIDE + 2;
/// Bits of a side.
pub(crate) const BITS: usize = 6;
/// Wrong bits of a tag that is taken. With two, one of 40 000 quadrilaterals with a black rim and random bits is taken.
const MAX_HAMMING: u32 = 2;

/// Bit by bit in rows from the upper left, the first one highest; 1 is white. The way up is that of AprilTag's pictures.
static CODES: std::sync::LazyLock<Vec<u64>> = std::sync::LazyLock::new(|| {
    let lines = include_str!("tag36h11.txt").lines();
    lines.filter_map(|line| u64::from_str_radix(line, 16).ok()).collect()
});

/// A tag that was recognised.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct RecognisedTag {
    pub(crate) id: u16,
    pub(crate) hamming: u32,
    /// Quarter turns clockwise of the picture against the tag.
    pub(crate) turns: usize,
}

/// The code of a tag; `None` for an id that the family does not have.
fn code(id: u16) -> Option<u64> {
    CODES.get(usize::from(id)).copied()
}

/// The modules of a tag and of the white around it, in rows: true for white. `None` for an id that the family does not have.
pub fn tag36h11_modules(id: u16) -> Option<[[bool; AROUND]; AROUND]> {
    let code = code(id)?;
    Some(std::array::from_fn(|row| {
        std::array::from_fn(|column| match ring(row, column) {
            0 => true,
            1 => false,
            _ => bit(code, row - 2, column - 2) == 1,
        })
    }))
}

/// Distance of a module from the outside: 0 in the white around, 1 in the rim.
pub(crate) fn ring(row: usize, column: usize) -> usize {
    let last = AROUND - 1;
    row.min(column).min(last - row).min(last - column)
}

/// Finds the tag whose bits are `seen`, turned in any way.
pub(crate) fn recognise(seen: u64) -> Option<RecognisedTag> {
    let mut turned = seen;
    let mut best: Option<RecognisedTag> = None;
    for turns in 0..4 {
        for (id, code) in CODES.iter().enumerate() {
            let hamming = (turned ^ code).count_ones();
            if hamming <= best.map_or(MAX_HAMMING, |best| best.hamming.saturating_sub(1)) {
                best = Some(RecognisedTag { id: id as u16, hamming, turns });
            }
        }
        turned = turn_back(turned);
    }
    best
}

/// The bits after a quarter turn counterclockwise.
fn turn_back(bits: u64) -> u64 {
    let mut turned = 0;
    for row in 0..BITS {
        for column in 0..BITS {
            // What was on the right is on top.
            turned = turned << 1 | bit(bits, column, BITS - 1 - row);
        }
    }
    turned
}

/// A bit in a row and column.
pub(crate) const fn bit(bits: u64, row: usize, column: usize) -> u64 {
    bits >> (BITS * BITS - 1 - (row * BITS + column)) & 1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tags_differ_by_eleven_bits_whichever_way_they_are_turned() {
        assert_eq!(CODES.len(), 587);
        for (index, code) in CODES.iter().enumerate() {
            let mut turned = *code;
            for turns in 0..4 {
                for (other, of) in CODES.iter().enumerate() {
                    let is_same = other == index && turns == 0;
                    assert!(is_same || (turned ^ of).count_ones() >= 11, "{index} turned {turns} and {other}");
                }
                turned = turn_back(turned);
            }
            assert_eq!(turned, *code);
        }
    }
}
