//! Detects the kind of a recording file and reads it: bytes, unpacked if compressed, or the records of a telemetry log.

use std::ffi::OsStr;
use std::fs::File;
use std::io::{BufRead, BufReader, ErrorKind, Read};
use std::path::Path;

use anyhow::{Context, Result};
use flate2::read::MultiGzDecoder;
use posebridge_protocol::framing::{VerifiedFrame, verify};
use posebridge_recording::container::unpack_recording;
use posebridge_recording::json_log::is_json_log;
use posebridge_recording::ros2::bag::is_bag;
use posebridge_recording::tlog::{FrameCheck, TlogReader, TlogRecord};

use crate::console::{print_line, progress_bar};

const CHUNK: usize = 64 * 1024;
/// RFC 1952, section 2.3.1.
const GZIP: [u8; 2] = [0x1F, 0x8B];
/// MCAP specification 0, "Magic".
const MCAP: &[u8] = b"\x89MCAP";
/// Offset of the first frame of a .tlog file, after its time.
const TLOG_FRAME: usize = posebridge_recording::tlog::TIME_BYTES;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InputKind {
    Own,
    Tlog,
    /// What `export --messages` writes to MCAP.
    Messages,
    /// Bytes from a link, without times.
    Bytes,
    /// Also a ROS 2 bag, for which one is made.
    Descriptor,
}

pub struct InputFile {
    pub kind: InputKind,
    pub name: String,
    /// Bytes on disk, before unpacking.
    pub size: u64,
    /// A compressed file was truncated; all data before was read.
    pub is_truncated: bool,
    is_compressed: bool,
    reader: Box<dyn BufRead>,
}

impl InputFile {
    /// Opens a file and detects its kind by the first bytes, and by the name where they are ambiguous.
    pub fn open(path: &Path) -> Result<Self> {
        let name = path.display().to_string();
        if path.is_dir() {
            // The folder of a bag; what is in it says who reads it.
            let reader = Box::new(std::io::empty());
            return Ok(Self {
                kind: InputKind::Descriptor,
                name,
                size: 0,
                is_truncated: false,
                is_compressed: false,
                reader,
            });
        }
        let file = File::open(path).with_context(|| format!("reading the recording `{name}`"))?;
        let size = file.metadata().with_context(|| format!("looking at `{name}`"))?.len();
        let mut plain = BufReader::with_capacity(CHUNK, file);
        let is_packed = beginning(&mut plain, &name)?.starts_with(&GZIP);
        let mut reader: Box<dyn BufRead> = if is_packed {
            Box::new(BufReader::with_capacity(CHUNK, MultiGzDecoder::new(plain)))
        } else {
            Box::new(plain)
        };
        let kind = kind_of(path, beginning(&mut reader, &name)?);
        Ok(Self { kind, name, size, is_truncated: false, is_compressed: is_packed, reader })
    }

    pub fn peek(&mut self) -> Result<&[u8]> {
        beginning(&mut self.reader, &self.name)
    }

    /// Passes the bytes in chunks until the end of the file. On an error the bytes before it were passed.
    pub fn chunks(&mut self, mut take: impl FnMut(&[u8])) -> Result<()> {
        self.chunks_while(|chunk| {
            take(chunk);
            true
        })
    }

    /// Passes the bytes in chunks until `needs_more` returns false or the file ends. A truncated compressed file ends there
    /// ([`Self::is_truncated`]).
    pub fn chunks_while(&mut self, mut needs_more: impl FnMut(&[u8]) -> bool) -> Result<()> {
        loop {
            let chunk = match self.reader.fill_buf() {
                Err(error) if self.is_compressed && ends_early(&error) => {
                    self.is_truncated = true;
                    return Ok(());
                }
                chunk => chunk.with_context(|| format!("reading `{}`", self.name))?,
            };
            let length = chunk.len();
            if length == 0 || !needs_more(chunk) {
                return Ok(());
            }
            self.reader.consume(length);
        }
    }

    pub fn warn_if_truncated(&self) {
        if self.is_truncated {
            print_line(&format!("`{}`: the packed bytes end in the middle; everything before is used", self.name));
        }
    }

    /// At most `most` bytes; of a truncated compressed file those before the truncation, with a printed note. The chunks of a recording are
    /// unpacked.
    pub fn read_all(mut self, most: u64) -> Result<Vec<u8>> {
        let mut bytes = Vec::new();
        if !self.is_compressed {
            // Refused before it fills the memory; it may still grow, and of a device the size says nothing.
            self.check_length(self.size, most)?;
        }
        let read = (&mut self.reader).take(most + 1).read_to_end(&mut bytes);
        match read {
            Err(error) if self.is_compressed && ends_early(&error) => {
                self.is_truncated = true;
                self.warn_if_truncated();
            }
            read => {
                read.with_context(|| format!("reading `{}`", self.name))?;
            }
        }
        self.check_length(bytes.len() as u64, most)?;
        if matches!(self.kind, InputKind::Own | InputKind::Messages) {
            bytes = unpack_recording(bytes, most).with_context(|| format!("`{}`", self.name))?;
        }
        Ok(bytes)
    }

    fn check_length(&self, length: u64, most: u64) -> Result<()> {
        anyhow::ensure!(length <= most, "`{}` holds more than {} MiB: cut it into parts", self.name, most >> 20);
        Ok(())
    }
}

/// Whether the error means that a compressed file was truncated; its format marks the end.
fn ends_early(error: &std::io::Error) -> bool {
    error.kind() == ErrorKind::UnexpectedEof
}

/// The buffered bytes; empty at the end.
fn beginning<'a>(reader: &'a mut impl BufRead, name: &str) -> Result<&'a [u8]> {
    reader.fill_buf().with_context(|| format!("reading `{name}`"))
}

fn kind_of(path: &Path, beginning: &[u8]) -> InputKind {
    if is_bag(beginning) {
        return InputKind::Descriptor;
    }
    if is_json_log(beginning) {
        return InputKind::Messages;
    }
    if beginning.starts_with(MCAP) {
        return InputKind::Own;
    }
    let unpacked = match path.file_stem() {
        Some(stem) if has_extension(path, "gz") => Path::new(stem),
        _ => path,
    };
    let is = |extension| has_extension(unpacked, extension);
    if is("toml") {
        InputKind::Descriptor
    } else if is("mcap") {
        InputKind::Own
    } else if is("tlog") {
        InputKind::Tlog
    } else if is("raw") || is("bin") {
        InputKind::Bytes
    } else if matches!(beginning.get(TLOG_FRAME), Some(0xFD | 0xFE)) {
        InputKind::Tlog
    } else {
        InputKind::Bytes
    }
}

fn has_extension(path: &Path, expected: &str) -> bool {
    path.extension().and_then(OsStr::to_str).is_some_and(|extension| extension.eq_ignore_ascii_case(expected))
}

/// Passes every record whose frame is intact or of an unknown message; returns the reader with its counts. On an error the records
/// before it were passed.
pub fn tlog_records(mut file: InputFile, mut take: impl FnMut(TlogRecord<'_, ()>)) -> Result<TlogReader> {
    let mut reader = TlogReader::new();
    let bar = progress_bar(file.size, "bytes")?;
    file.chunks(|chunk| {
        reader.push(chunk, &mut classify, &mut take);
        bar.inc(chunk.len() as u64);
    })?;
    reader.finish(&mut classify, &mut take);
    bar.finish_and_clear();
    file.warn_if_truncated();
    Ok(reader)
}

/// Passes the first records until `needs_more` returns false.
pub fn first_tlog_records(mut file: InputFile, mut needs_more: impl FnMut(TlogRecord<'_, ()>) -> bool) -> Result<()> {
    let mut reader = TlogReader::new();
    let mut is_unfinished = true;
    file.chunks_while(|chunk| {
        reader.push(chunk, &mut classify, &mut |record| {
            is_unfinished = is_unfinished && needs_more(record);
        });
        is_unfinished
    })?;
    reader.finish(&mut classify, &mut |record| {
        is_unfinished = is_unfinished && needs_more(record);
    });
    Ok(())
}

fn classify(raw: &[u8]) -> FrameCheck<()> {
    match verify(raw) {
        VerifiedFrame::Frame(_) => FrameCheck::Valid(()),
        VerifiedFrame::UnknownFrame(_) => FrameCheck::Unknown(()),
        VerifiedFrame::Invalid => FrameCheck::Invalid,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_kind_is_told_by_the_bytes_first_and_then_by_the_name() {
        let of = |name: &str, bytes: &[u8]| kind_of(Path::new(name), bytes);
        let record = [0, 6, 0x60, 0xBE, 0x90, 0x38, 2, 0xCB, 0xFD, 9];
        assert_eq!(of("a.tlog", b"\x89MCAP0\r\n"), InputKind::Own);
        let ros = b"\x89MCAP0\r\n\x01\x0C\0\0\0\0\0\0\0\x04\0\0\0ros2\0\0\0\0";
        assert_eq!(of("a.mcap", ros), InputKind::Descriptor);
        assert_eq!(of("a.TLOG.gz", &record), InputKind::Tlog);
        assert_eq!(of("a", &record), InputKind::Tlog);
        assert_eq!(of("a.raw", &record), InputKind::Bytes);
        assert_eq!(of("a.toml", b"name = 'x'"), InputKind::Descriptor);
        assert_eq!(of("a", b""), InputKind::Bytes);
    }
}
