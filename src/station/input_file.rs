//! What kind of recording a file is, and its bytes, unpacked if they are packed; of a telemetry log its records.

use std::ffi::OsStr;
use std::fs::File;
use std::io::{BufRead, BufReader, ErrorKind, Read};
use std::path::Path;

use anyhow::{Context, Result};
use flate2::read::MultiGzDecoder;
use posebridge_protocol::framing::{VerifiedFrame, verify};
use posebridge_recording::tlog::{FrameCheck, TlogReader, TlogRecord};

use crate::console::{print_line, progress_bar};

const CHUNK: usize = 256 * 1024;
/// The first bytes of a gzip file (RFC 1952, section 2.3.1).
const GZIP: [u8; 2] = [0x1F, 0x8B];
/// The first bytes of an MCAP file (MCAP specification 0, "Magic").
const MCAP: &[u8] = b"\x89MCAP";
/// Where the first frame of a .tlog file begins, behind its time.
const TLOG_FRAME: usize = posebridge_recording::tlog::TIME_BYTES;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InputKind {
    Own,
    Tlog,
    /// Bytes as they came off a link, without times.
    Bytes,
    Descriptor,
}

pub struct InputFile {
    pub kind: InputKind,
    pub name: String,
    /// Its size on the disk, in bytes; packed, if it is.
    pub size: u64,
    /// A packed file that ends in the middle: everything before was given.
    pub is_truncated: bool,
    is_compressed: bool,
    reader: Box<dyn BufRead>,
}

impl InputFile {
    /// Opens a file and finds out what it is: by its first bytes, and where they are ambiguous by its name.
    pub fn open(path: &Path) -> Result<Self> {
        let name = path.display().to_string();
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

    /// The first bytes; they stay in the stream.
    pub fn peek(&mut self) -> Result<&[u8]> {
        beginning(&mut self.reader, &self.name)
    }

    /// Gives the bytes in chunks, to the end of the file.
    /// What came before an error was given.
    pub fn chunks(&mut self, mut take: impl FnMut(&[u8])) -> Result<()> {
        self.chunks_while(|chunk| {
            take(chunk);
            true
        })
    }

    /// Gives the bytes in chunks for as long as more are wanted, at most to the end of the file. A packed file that was cut ends where
    /// it was cut ([`Self::is_truncated`]).
    pub fn chunks_while(&mut self, mut wants_more: impl FnMut(&[u8]) -> bool) -> Result<()> {
        loop {
            let chunk = match self.reader.fill_buf() {
                Err(error) if self.is_compressed && ends_early(&error) => {
                    self.is_truncated = true;
                    return Ok(());
                }
                chunk => chunk.with_context(|| format!("reading `{}`", self.name))?,
            };
            let length = chunk.len();
            if length == 0 || !wants_more(chunk) {
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

    /// All bytes, at most `most` of them; of a packed file that was cut those before, and a note says so.
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
        Ok(bytes)
    }

    fn check_length(&self, length: u64, most: u64) -> Result<()> {
        anyhow::ensure!(length <= most, "`{}` holds more than {} MiB: cut it into parts", self.name, most >> 20);
        Ok(())
    }
}

/// Whether reading ended because a packed file was cut: it has an end of its own, so that this is known.
fn ends_early(error: &std::io::Error) -> bool {
    error.kind() == ErrorKind::UnexpectedEof
}

/// What lies ready to be read; nothing at the end.
fn beginning<'a>(reader: &'a mut impl BufRead, name: &str) -> Result<&'a [u8]> {
    reader.fill_buf().with_context(|| format!("reading `{name}`"))
}

fn kind_of(path: &Path, beginning: &[u8]) -> InputKind {
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

fn has_extension(path: &Path, wanted: &str) -> bool {
    path.extension().and_then(OsStr::to_str).is_some_and(|extension| extension.eq_ignore_ascii_case(wanted))
}

/// Gives every record of a file whose frame is whole or of an unknown message, and then the reader, which has counted.
/// What came before an error was given.
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

/// Gives the first records of a file for as long as more are wanted.
pub fn first_tlog_records(mut file: InputFile, mut wants_more: impl FnMut(TlogRecord<'_, ()>) -> bool) -> Result<()> {
    let mut reader = TlogReader::new();
    let mut is_wanted = true;
    file.chunks_while(|chunk| {
        reader.push(chunk, &mut classify, &mut |record| {
            is_wanted = is_wanted && wants_more(record);
        });
        is_wanted
    })?;
    reader.finish(&mut classify, &mut |record| {
        is_wanted = is_wanted && wants_more(record);
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
        assert_eq!(of("a.TLOG.gz", &record), InputKind::Tlog);
        assert_eq!(of("a", &record), InputKind::Tlog);
        assert_eq!(of("a.raw", &record), InputKind::Bytes);
        assert_eq!(of("a.toml", b"name = 'x'"), InputKind::Descriptor);
        assert_eq!(of("a", b""), InputKind::Bytes);
    }
}
