//! Splits bytes into lines, independent of chunking.
//!
//! A line ends with LF, CR or both; empty ones do not count. A line that exceeds the longest one is dropped to its end,
//! so that no sender can fill the memory.

const MAX_QUOTED: usize = 80;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum SplitItem<'a> {
    Line(&'a [u8]),
    /// Number of bytes without a line end.
    TooLong(u32),
}

/// An incomplete line of at most `LONGEST` bytes without its end.
#[derive(Debug, Default)]
pub(super) struct LineSplitter<const LONGEST: usize> {
    line: Vec<u8>,
    dropped: u32,
}

impl<const LONGEST: usize> LineSplitter<LONGEST> {
    /// Drops the incomplete line, and returns its length in bytes.
    pub(super) fn clear(&mut self) -> u32 {
        let bytes = self.waiting_bytes();
        self.line.clear();
        self.dropped = 0;
        bytes
    }

    pub(super) const fn waiting_bytes(&self) -> u32 {
        self.dropped.saturating_add(self.line.len() as u32)
    }

    pub(super) fn finish(&mut self, sink: &mut dyn FnMut(SplitItem<'_>)) {
        if self.dropped > 0 {
            sink(SplitItem::TooLong(self.dropped));
        } else if !self.line.is_empty() {
            sink(SplitItem::Line(&self.line));
        }
        self.clear();
    }

    pub(super) fn push(&mut self, bytes: &[u8], sink: &mut dyn FnMut(SplitItem<'_>)) {
        for byte in bytes {
            if matches!(byte, b'\n' | b'\r') {
                self.finish(sink);
            } else if self.dropped > 0 {
                self.dropped = self.dropped.saturating_add(1);
            } else if self.line.len() < LONGEST {
                self.line.push(*byte);
            } else {
                self.dropped = LONGEST as u32 + 1;
                self.line.clear();
            }
        }
    }
}

pub(super) fn printable(line: &[u8]) -> String {
    let shown = line.iter().take(MAX_QUOTED);
    let shown = shown.map(|byte| match byte {
        0x20..=0x7E => char::from(*byte),
        _ => '.',
    });
    shown.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const LONGEST: usize = 256;

    fn cuts(bytes: &[u8]) -> Vec<Result<Vec<u8>, u32>> {
        let mut splitter = LineSplitter::<LONGEST>::default();
        let mut cuts = Vec::new();
        splitter.push(bytes, &mut |cut| {
            cuts.push(match cut {
                SplitItem::Line(line) => Ok(line.to_vec()),
                SplitItem::TooLong(bytes) => Err(bytes),
            });
        });
        cuts
    }

    #[test]
    fn lines_end_with_either_or_both() {
        let lines: Vec<_> = [b"a", b"b", b"c", b"d"].map(|line| Ok(line.to_vec())).into();
        assert_eq!(cuts(b"\na\nb\rc\r\n\r\nd\n\re"), lines);
    }

    #[test]
    fn the_longest_line_is_complete_and_a_longer_one_is_dropped_to_its_end() {
        let mut bytes = vec![b'x'; LONGEST];
        bytes.push(b'\n');
        assert_eq!(cuts(&bytes), [Ok(vec![b'x'; LONGEST])]);
        let mut bytes = vec![b'x'; 2 * LONGEST];
        bytes.extend(b"\nok\n");
        assert_eq!(cuts(&bytes), [Err(2 * LONGEST as u32), Ok(b"ok".to_vec())]);
    }
}
