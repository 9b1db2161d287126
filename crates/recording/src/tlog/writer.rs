//! Writes a `.tlog` file.

use std::io::Write;

/// Writes records to `W`; what was flushed is readable whatever follows, because the format has no end.
#[derive(Debug)]
pub struct TlogWriter<W: Write> {
    out: W,
    latest_micros: u64,
    scratch: Vec<u8>,
}

impl<W: Write> TlogWriter<W> {
    /// Begins a file; nothing is written before the first record.
    pub const fn new(out: W) -> Self {
        Self { out, latest_micros: 0, scratch: Vec::new() }
    }

    /// Writes that `frame`, one whole frame, was received or sent at `micros` since 1970 UTC. Times never step back in the file, because
    /// players take a step back for the end: an earlier one is written as the latest before it.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn record(&mut self, micros: u64, frame: &[u8]) -> std::io::Result<()> {
        self.latest_micros = self.latest_micros.max(micros);
        // One call for both, so that a file that is cut off by a full disk ends between two records if it can.
        self.scratch.clear();
        self.scratch.extend(self.latest_micros.to_be_bytes());
        self.scratch.extend_from_slice(frame);
        self.out.write_all(&self.scratch)
    }

    /// Hands everything on to the system.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn flush(&mut self) -> std::io::Result<()> {
        self.out.flush()
    }

    /// Ends the file and gives `W` back.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn finish(mut self) -> std::io::Result<W> {
        self.out.flush()?;
        Ok(self.out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_record_is_a_big_endian_time_and_the_frame_and_times_never_step_back() {
        let mut writer = TlogWriter::new(Vec::new());
        writer.record(0x0006_60BE_9038_02CB, &[0xFD, 1]).unwrap();
        writer.record(5, &[0xFE]).unwrap();
        let time = [0x00, 0x06, 0x60, 0xBE, 0x90, 0x38, 0x02, 0xCB];
        let expected = [&time[..], &[0xFD, 1], &time, &[0xFE]].concat();
        assert_eq!(writer.finish().unwrap(), expected);
    }
}
