//! Videos of JPEG pictures in AVI files (MJPEG), as cameras, OpenCV and ffmpeg write them, with the OpenDML extensions for large files.

use std::io::Read;

use crate::grey_picture::{GreyPicture, PictureError};
use crate::riff::{AviCutOff, RiffItem, RiffReader};
use crate::video_frame::{FrameRate, VideoFrame};

/// Largest picture, bytes; a larger one is an error, and is skipped.
const MAX_PICTURE_BYTES: u32 = 16 << 20;
/// Largest chunk of the header that is read, bytes.
const MAX_HEADER_BYTES: u32 = 1 << 16;

/// A file that is no MJPEG in AVI, or one of its pictures that is damaged. Offsets are bytes from the file's beginning.
#[derive(Debug, thiserror::Error)]
pub enum AviError {
    #[error("it is no AVI file: that begins with `RIFF`, a size and `AVI `")]
    OtherFormat,
    #[error("byte {offset}: the file ends before its pictures (the list `movi`)")]
    NoMovie { offset: u64 },
    #[error("byte {offset}: the chunk `{chunk}` has {bytes} bytes, which is no header of a stream")]
    HeaderChunk { offset: u64, chunk: String, bytes: u32 },
    #[error("byte {offset}: none of the streams before has pictures")]
    NoVideo { offset: u64 },
    #[error(
        "byte {offset}: the pictures are `{codec}`, only MJPG is read; convert with `ffmpeg -i FILE -c:v mjpeg -q:v 3 OUT.avi`"
    )]
    OtherCodec { offset: u64, codec: String },
    #[error(
        "byte {offset}: the rate of frames is unknown, so they have no times; convert with `ffmpeg -r RATE -i FILE -c:v copy OUT.avi`"
    )]
    UnknownRate { offset: u64 },
    #[error("byte {offset}: picture {number} has {bytes} bytes; at most {MAX_PICTURE_BYTES} are read")]
    LongPicture { offset: u64, number: u64, bytes: u32 },
    #[error("byte {offset}: picture {number}: {source}")]
    Picture { offset: u64, number: u64, source: PictureError },
    #[error(
        "byte {offset}: picture {number} has half the rows; convert with `ffmpeg -i FILE -vf yadif -c:v mjpeg -q:v 3 OUT.avi`"
    )]
    Interlaced { offset: u64, number: u64 },
    #[error("byte {offset}: {source}")]
    Read { offset: u64, source: std::io::Error },
}

/// Reads the pictures of the first MJPEG stream, one after the other; the input need not seek.
#[derive(Debug)]
pub struct AviReader<R> {
    riff: RiffReader<R>,
    stream: VideoStream,
    jpeg: Vec<u8>,
    /// Number of the next frame.
    next: u64,
    has_ended: bool,
    cut_off: Option<AviCutOff>,
}

impl<R: Read> AviReader<R> {
    /// Reads the header.
    pub fn new(input: R) -> Result<Self, AviError> {
        let mut riff = RiffReader::new(input);
        let mut streams = StreamHeaders::default();
        let mut content = Vec::new();
        let mut is_avi = false;
        loop {
            let offset = riff.offset();
            let read = |source| AviError::Read { offset, source };
            match riff.next_item().map_err(read)? {
                RiffItem::Begin(kind) if !is_avi && &kind == b"AVI " => is_avi = true,
                _ if !is_avi => return Err(AviError::OtherFormat),
                RiffItem::Begin(kind) if &kind == b"movi" => {
                    let stream = streams.choose(offset)?;
                    return Ok(Self { riff, stream, jpeg: content, next: 0, has_ended: false, cut_off: None });
                }
                RiffItem::Begin(_) => {}
                RiffItem::Chunk { id, bytes }
                    if [b"avih", b"strh", b"strf"].contains(&&id) && bytes <= MAX_HEADER_BYTES =>
                {
                    if riff.read_content(bytes, &mut content).map_err(read)?.is_some() {
                        return Err(AviError::NoMovie { offset });
                    }
                    let is_read = streams.push(id, &content, offset);
                    is_read.ok_or_else(|| AviError::HeaderChunk { offset, chunk: printable(&id), bytes })?;
                }
                RiffItem::Chunk { bytes, .. } => {
                    riff.skip_content(bytes).map_err(read)?;
                }
                RiffItem::End(_) => return Err(AviError::NoMovie { offset }),
            }
        }
    }

    pub const fn rate(&self) -> FrameRate {
        self.stream.rate
    }

    /// Why the pictures may be incomplete; known at the end.
    pub const fn cut_off(&self) -> Option<AviCutOff> {
        self.cut_off
    }

    /// Replaces `picture` by the brightness of the next frame. `None` at the end. After an error of one picture, the next one can be read;
    /// after [`AviError::Read`] there is nothing more.
    ///
    /// An empty chunk stands for a frame that the camera dropped: it has its time, but is not given.
    pub fn read_frame(&mut self, picture: &mut GreyPicture) -> Result<Option<VideoFrame>, AviError> {
        picture.clear();
        while !self.has_ended {
            let offset = self.riff.offset();
            match self.read_item(offset, picture) {
                Ok(None) => {}
                Ok(Some(frame)) => return Ok(Some(frame)),
                Err(error) => {
                    picture.clear();
                    self.has_ended |= matches!(error, AviError::Read { .. });
                    return Err(error);
                }
            }
        }
        Ok(None)
    }

    /// `None` if it gave no picture.
    fn read_item(&mut self, offset: u64, picture: &mut GreyPicture) -> Result<Option<VideoFrame>, AviError> {
        let read = |source| AviError::Read { offset, source };
        match self.riff.next_item().map_err(read)? {
            RiffItem::Begin(_) => {}
            RiffItem::Chunk { id, bytes: 0 } if self.stream.has(id) => self.next += 1,
            RiffItem::Chunk { id, bytes } if self.stream.has(id) => {
                let number = self.next;
                self.next += 1;
                let is_long = bytes > MAX_PICTURE_BYTES;
                let cut_off =
                    if is_long { self.riff.skip_content(bytes) } else { self.riff.read_content(bytes, &mut self.jpeg) };
                if let Some(cut_off) = cut_off.map_err(read)? {
                    self.end(Some(cut_off));
                } else if is_long {
                    return Err(AviError::LongPicture { offset, number, bytes });
                } else {
                    self.decode(offset, number, picture)?;
                    return Ok(Some(VideoFrame { number, time_s: self.stream.rate.time_s(number), offset }));
                }
            }
            RiffItem::Chunk { bytes, .. } => {
                if let Some(cut_off) = self.riff.skip_content(bytes).map_err(read)? {
                    self.end(Some(cut_off));
                }
            }
            RiffItem::End(cut_off) => self.end(cut_off),
        }
        Ok(None)
    }

    fn decode(&self, offset: u64, number: u64, picture: &mut GreyPicture) -> Result<(), AviError> {
        picture.decode_jpeg(&self.jpeg).map_err(|source| AviError::Picture { offset, number, source })?;
        // Each half of an interlaced frame is a JPEG picture of its own.
        let is_half = picture.image().is_some_and(|image| 2 * image.height() == self.stream.rows);
        if is_half { Err(AviError::Interlaced { offset, number }) } else { Ok(()) }
    }

    const fn end(&mut self, cut_off: Option<AviCutOff>) {
        self.has_ended = true;
        self.cut_off = cut_off;
    }
}

/// The stream whose pictures are read.
#[derive(Clone, Copy, Debug)]
struct VideoStream {
    /// The first two characters of its chunks.
    digits: [u8; 2],
    rows: usize,
    rate: FrameRate,
}

impl VideoStream {
    fn has(&self, [a, b, kind @ ..]: [u8; 4]) -> bool {
        [a, b] == self.digits && [b"dc", b"db"].contains(&&kind)
    }
}

/// What the header says of the streams, as far as it was read.
#[derive(Debug, Default)]
struct StreamHeaders {
    frame_micros: u32,
    count: u8,
    last: StreamHeader,
    /// The first MJPEG stream: which, its header, its rows.
    found: Option<(u8, StreamHeader, u32)>,
    /// The codec of the first other stream of pictures, and where it stands.
    refused: Option<(u64, String)>,
}

/// Of the chunk `strh`.
#[derive(Clone, Copy, Debug, Default)]
struct StreamHeader {
    is_video: bool,
    scale: u32,
    rate: u32,
}

impl StreamHeaders {
    /// `None` if the chunk is too short.
    fn push(&mut self, id: [u8; 4], content: &[u8], offset: u64) -> Option<()> {
        match &id {
            b"avih" => self.frame_micros = number(content, 0)?,
            b"strh" => {
                let is_video = content.starts_with(b"vids");
                self.last = StreamHeader { is_video, scale: number(content, 20)?, rate: number(content, 24)? };
                self.count = self.count.saturating_add(1);
            }
            // The header of a bitmap; that of sound is shorter.
            _ if self.last.is_video => {
                let (rows, codec) = (number(content, 8)?, content.get(16..20)?);
                if codec.eq_ignore_ascii_case(b"MJPG") {
                    self.found = self.found.or(Some((self.count - 1, self.last, rows)));
                } else if self.refused.is_none() {
                    self.refused = Some((offset, printable(codec)));
                }
            }
            _ => {}
        }
        Some(())
    }

    fn choose(self, offset: u64) -> Result<VideoStream, AviError> {
        let Some((index, header, rows)) = self.found else {
            let other = |(offset, codec)| AviError::OtherCodec { offset, codec };
            return Err(self.refused.map_or(AviError::NoVideo { offset }, other));
        };
        let rate = FrameRate::new(header.rate, header.scale).or_else(|| FrameRate::new(1_000_000, self.frame_micros));
        let rate = rate.ok_or(AviError::UnknownRate { offset })?;
        // Below zero, the rows of a bitmap stand from the top.
        let rows = rows.cast_signed().unsigned_abs() as usize;
        Ok(VideoStream { digits: [b'0' + index / 10, b'0' + index % 10], rows, rate })
    }
}

fn number(bytes: &[u8], at: usize) -> Option<u32> {
    bytes.get(at..)?.first_chunk().map(|bytes| u32::from_le_bytes(*bytes))
}

fn printable(id: &[u8]) -> String {
    id.escape_ascii().to_string()
}
