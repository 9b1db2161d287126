//! Videos as uncompressed planes: YUV4MPEG2, as ffmpeg and mjpegtools write it (`man 5 yuv4mpeg`).

use std::io::{BufRead, BufReader, Read, copy, sink};

use crate::grey_picture::{GreyPicture, MAX_SIDE};
use crate::video_frame::{FrameRate, VideoFrame};

/// First word of the header.
const MAGIC: &str = "YUV4MPEG2";
/// First word before each frame.
const FRAME: &str = "FRAME";
/// Longest header of the stream or of a frame, bytes; mjpegtools allow 256.
const MAX_HEADER_BYTES: usize = 1_024;

/// A stream that is no YUV4MPEG2, or is damaged. Offsets are bytes from its beginning.
#[derive(Debug, thiserror::Error)]
pub enum Y4mError {
    #[error("it is no YUV4MPEG2 stream: that begins with `{MAGIC}`")]
    OtherFormat,
    #[error("byte {offset}: the line has no end within {MAX_HEADER_BYTES} bytes")]
    EndlessLine { offset: u64 },
    #[error("byte {offset}: the file ends inside the line that begins here")]
    CutOffLine { offset: u64 },
    #[error("byte {offset}: `{parameter}` is not read as {meaning}")]
    Parameter { offset: u64, parameter: String, meaning: &'static str },
    #[error("the header has no {0}")]
    Missing(&'static str),
    #[error(
        "byte {offset}: the rate of frames is unknown (`{parameter}`), so they have no times; write the stream with `ffmpeg -r RATE`"
    )]
    UnknownRate { offset: u64, parameter: String },
    #[error(
        "byte {offset}: samples of `{parameter}` have more than 8 bits; convert with `ffmpeg -i FILE -pix_fmt yuv420p OUT.y4m`"
    )]
    DeepSamples { offset: u64, parameter: String },
    #[error(
        "byte {offset}: frames of {width} x {height} pixels; the longest side may have {MAX_SIDE}, and none may be 0"
    )]
    Size { offset: u64, width: u64, height: u64 },
    #[error("byte {offset}: frame {number} should begin with `{FRAME}`")]
    NoFrame { offset: u64, number: u64 },
    #[error("byte {offset}: frame {number} ends {missing} bytes too early, in its {part}")]
    CutOff { offset: u64, number: u64, missing: u64, part: &'static str },
    #[error("byte {offset}: {source}")]
    Read { offset: u64, source: std::io::Error },
}

/// Reads the frames of a stream, one after the other.
#[derive(Debug)]
pub struct Y4mReader<R> {
    input: BufReader<R>,
    /// Bytes that were read.
    offset: u64,
    width: usize,
    height: usize,
    rate: FrameRate,
    chroma_bytes: u64,
    /// Number of the next frame; `None` at the end and after an error.
    next: Option<u64>,
}

impl<R: Read> Y4mReader<R> {
    /// Reads the header.
    pub fn new(input: R) -> Result<Self, Y4mError> {
        let mut input = BufReader::new(input);
        let mut magic = Vec::new();
        let read = input.by_ref().take(MAGIC.len() as u64).read_to_end(&mut magic);
        read.map_err(|source| Y4mError::Read { offset: 0, source })?;
        if magic != MAGIC.as_bytes() {
            return Err(Y4mError::OtherFormat);
        }
        let line = read_line(&mut input, 0)?.ok_or(Y4mError::CutOffLine { offset: 0 })?;
        let header = Header::parse(&line)?;
        Ok(Self {
            input,
            offset: (MAGIC.len() + line.len()) as u64 + 1,
            width: header.width,
            height: header.height,
            rate: header.rate,
            chroma_bytes: header.chroma_bytes,
            next: Some(0),
        })
    }

    pub const fn width(&self) -> usize {
        self.width
    }

    pub const fn height(&self) -> usize {
        self.height
    }

    pub const fn rate(&self) -> FrameRate {
        self.rate
    }

    /// Replaces `picture` by the brightness of the next frame. `None` at the end; after an error there is nothing more.
    pub fn read_frame(&mut self, picture: &mut GreyPicture) -> Result<Option<VideoFrame>, Y4mError> {
        picture.clear();
        let Some(number) = self.next.take() else { return Ok(None) };
        let frame = self.read_numbered(number, picture);
        if let Ok(Some(_)) = frame {
            self.next = Some(number + 1);
        } else {
            picture.clear();
        }
        frame
    }

    fn read_numbered(&mut self, number: u64, picture: &mut GreyPicture) -> Result<Option<VideoFrame>, Y4mError> {
        let frame = VideoFrame { number, time_s: self.rate.time_s(number), offset: self.offset };
        let Some(line) = read_line(&mut self.input, self.offset)? else { return Ok(None) };
        if line != FRAME.as_bytes() && !line.starts_with(b"FRAME ") {
            return Err(Y4mError::NoFrame { offset: self.offset, number });
        }
        self.offset += line.len() as u64 + 1;
        let luma_bytes = (self.width * self.height) as u64;
        let read = picture.read_pixels(&mut self.input, self.width, self.height);
        let luma = self.advance(read.map(|read| read as u64))?;
        let cut_off = |missing, part| Y4mError::CutOff { offset: frame.offset, number, missing, part };
        if luma < luma_bytes {
            return Err(cut_off(luma_bytes - luma + self.chroma_bytes, "brightness"));
        }
        let read = copy(&mut self.input.by_ref().take(self.chroma_bytes), &mut sink());
        let chroma = self.advance(read)?;
        if chroma < self.chroma_bytes {
            return Err(cut_off(self.chroma_bytes - chroma, "colours"));
        }
        Ok(Some(frame))
    }

    fn advance(&mut self, read: std::io::Result<u64>) -> Result<u64, Y4mError> {
        let read = read.map_err(|source| Y4mError::Read { offset: self.offset, source })?;
        self.offset += read;
        Ok(read)
    }
}

/// Without its line end; `None` at the end of the input.
fn read_line(input: &mut impl BufRead, offset: u64) -> Result<Option<Vec<u8>>, Y4mError> {
    let mut line = Vec::new();
    let read = input.take(MAX_HEADER_BYTES as u64).read_until(b'\n', &mut line);
    let read = read.map_err(|source| Y4mError::Read { offset, source })?;
    match line.pop() {
        None => Ok(None),
        Some(b'\n') => Ok(Some(line)),
        Some(_) if read == MAX_HEADER_BYTES => Err(Y4mError::EndlessLine { offset }),
        Some(_) => Err(Y4mError::CutOffLine { offset }),
    }
}

struct Header {
    width: usize,
    height: usize,
    rate: FrameRate,
    chroma_bytes: u64,
}

/// A parameter of the header, and where it stands.
struct Parameter {
    offset: u64,
    /// Begins with the letter that names it.
    text: String,
}

impl Parameter {
    fn value(&self) -> &str {
        self.text.get(1..).unwrap_or_default()
    }

    fn error(&self, meaning: &'static str) -> Y4mError {
        Y4mError::Parameter { offset: self.offset, parameter: self.text.clone(), meaning }
    }
}

impl Header {
    /// Of the parameters behind the magic.
    fn parse(line: &[u8]) -> Result<Self, Y4mError> {
        let (mut width, mut height, mut rate, mut space) = (None, None, None, None);
        let mut offset = MAGIC.len() as u64;
        for text in line.split(|byte| *byte == b' ') {
            let parameter = Parameter { offset, text: String::from_utf8_lossy(text).into_owned() };
            match text.first() {
                Some(b'W') => width = Some(parameter),
                Some(b'H') => height = Some(parameter),
                Some(b'F') => rate = Some(parameter),
                Some(b'C') => space = Some(parameter),
                // Interlacing, the shape of pixels, comments, and what there may be one day.
                _ => {}
            }
            offset += text.len() as u64 + 1;
        }
        let width = width.ok_or(Y4mError::Missing("width (W)"))?;
        let height = height.ok_or(Y4mError::Missing("height (H)"))?;
        let rate = rate.ok_or(Y4mError::Missing("rate of frames (F)"))?;
        // The default of the format.
        let space = space.unwrap_or_else(|| Parameter { offset, text: "C420".to_owned() });
        let (columns, rows) = (parse_side(&width)?, parse_side(&height)?);
        let is_fit = |side: u64| (1..=MAX_SIDE as u64).contains(&side);
        if !is_fit(columns) || !is_fit(rows) {
            return Err(Y4mError::Size { offset: width.offset, width: columns, height: rows });
        }
        Ok(Self {
            width: columns as usize,
            height: rows as usize,
            rate: parse_rate(&rate)?,
            chroma_bytes: parse_chroma_bytes(&space, columns, rows)?,
        })
    }
}

fn parse_side(parameter: &Parameter) -> Result<u64, Y4mError> {
    parameter.value().parse().map_err(|_none| parameter.error("a number of pixels"))
}

fn parse_rate(parameter: &Parameter) -> Result<FrameRate, Y4mError> {
    let numbers =
        parameter.value().split_once(':').and_then(|(above, below)| Some((above.parse().ok()?, below.parse().ok()?)));
    let (above, below) = numbers.ok_or_else(|| parameter.error("a fraction"))?;
    let unknown = || Y4mError::UnknownRate { offset: parameter.offset, parameter: parameter.text.clone() };
    FrameRate::new(above, below).ok_or_else(unknown)
}

/// Bytes behind the brightness of each frame: planes of colour, whose sides are rounded up, and of transparency.
fn parse_chroma_bytes(parameter: &Parameter, width: u64, height: u64) -> Result<u64, Y4mError> {
    match parameter.value() {
        "420" | "420jpeg" | "420mpeg2" | "420paldv" => Ok(2 * width.div_ceil(2) * height.div_ceil(2)),
        "411" => Ok(2 * width.div_ceil(4) * height),
        "422" => Ok(2 * width.div_ceil(2) * height),
        "444" => Ok(2 * width * height),
        "444alpha" => Ok(3 * width * height),
        "mono" => Ok(0),
        other if has_deep_samples(other) => {
            Err(Y4mError::DeepSamples { offset: parameter.offset, parameter: parameter.text.clone() })
        }
        _ => Err(parameter.error("a colour space of 8 bits (420, 422, 444, 411, 444alpha or mono)")),
    }
}

/// Such as `420p10` and `mono16`.
fn has_deep_samples(space: &str) -> bool {
    let bits = space.strip_prefix("mono").or_else(|| space.split_once('p').map(|(_, bits)| bits));
    bits.and_then(|bits| bits.parse::<u8>().ok()).is_some_and(|bits| (9..=16).contains(&bits))
}
