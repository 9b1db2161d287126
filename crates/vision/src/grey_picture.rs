//! Pictures of files and cameras as grey pixels: JPEG, PNG, and PGM (netpbm's P5).

use std::borrow::Cow;
use std::io::{Cursor, Read};

use png::{ColorType, Transformations};
use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

use crate::grey_image::GreyImage;

/// Longest side that is decoded, px: a camera of 16 megapixels.
pub(crate) const MAX_SIDE: usize = 4_928;
/// First bytes of every PNG picture.
const PNG_SIGNATURE: &[u8] = b"\x89PNG\r\n\x1A\n";
/// Most memory for what a PNG picture says beside its pixels, bytes.
const MAX_PNG_EXTRA_BYTES: usize = 16 << 20;

/// A picture that could not be decoded.
#[derive(Debug, thiserror::Error)]
pub enum PictureError {
    #[error("it is neither a JPEG nor a PNG nor a PGM picture")]
    OtherFormat,
    #[error("the picture is damaged: {0}")]
    Damaged(String),
    #[error("the picture has {width} x {height} pixels; the longest side may have {MAX_SIDE}")]
    TooLarge { width: usize, height: usize },
}

/// A decoded picture; its memory serves the next one as well.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct GreyPicture {
    pixels: Vec<u8>,
    width: usize,
    height: usize,
}

impl GreyPicture {
    /// Replaces it by a picture of any of the formats. After an error it is empty.
    pub fn decode(&mut self, bytes: &[u8]) -> Result<(), PictureError> {
        match bytes {
            [0xFF, 0xD8, ..] => self.decode_jpeg(bytes),
            [b'P', b'5', rest @ ..] => self.decode_pgm(rest),
            _ if bytes.starts_with(PNG_SIGNATURE) => self.decode_png(bytes),
            _ => {
                self.clear();
                Err(PictureError::OtherFormat)
            }
        }
    }

    /// What follows the magic number: width, height and the largest value in decimals, with comments between them, then a byte for each
    /// pixel.
    fn decode_pgm(&mut self, bytes: &[u8]) -> Result<(), PictureError> {
        self.clear();
        let damaged = |what: &str| PictureError::Damaged(what.to_owned());
        let mut rest = bytes;
        let mut numbers = [0_usize; 3];
        for number in &mut numbers {
            while let [first, after @ ..] = rest {
                match first {
                    b'#' => rest = &rest[rest.iter().position(|byte| *byte == b'\n').unwrap_or(rest.len())..],
                    space if space.is_ascii_whitespace() => rest = after,
                    _ => break,
                }
            }
            let digits = rest.iter().take_while(|byte| byte.is_ascii_digit()).count();
            let text = std::str::from_utf8(&rest[..digits]).unwrap_or_default();
            *number = text.parse().map_err(|_none| damaged("its header needs width, height and the largest value"))?;
            rest = &rest[digits..];
        }
        let [width, height, most] = numbers;
        if width.max(height) > MAX_SIDE {
            return Err(PictureError::TooLarge { width, height });
        }
        // As in the other formats: what was decoded has pixels.
        if width.min(height) == 0 {
            return Err(damaged("it has no pixels"));
        }
        // One blank ends the header.
        let pixels =
            rest.get(1..).and_then(|rest| rest.get(..width * height)).ok_or_else(|| damaged("it ends too early"))?;
        if most != 255 {
            return Err(damaged("only PGM with a largest value of 255 is read"));
        }
        self.pixels.clear();
        self.pixels.extend_from_slice(pixels);
        (self.width, self.height) = (width, height);
        Ok(())
    }

    /// The brightness of each pixel by ITU-R BT.601; transparency changes nothing.
    fn decode_png(&mut self, bytes: &[u8]) -> Result<(), PictureError> {
        self.clear();
        let damaged = |error: png::DecodingError| PictureError::Damaged(error.to_string());
        let limits = png::Limits { bytes: MAX_PNG_EXTRA_BYTES };
        let mut decoder = png::Decoder::new_with_limits(Cursor::new(bytes), limits);
        decoder.set_transformations(Transformations::EXPAND | Transformations::STRIP_16);
        decoder.set_ignore_text_chunk(true);
        decoder.set_ignore_iccp_chunk(true);
        let info = decoder.read_header_info().map_err(damaged)?;
        let (width, height) = (info.width as usize, info.height as usize);
        if width.max(height) > MAX_SIDE {
            return Err(PictureError::TooLarge { width, height });
        }
        let mut reader = decoder.read_info().map_err(damaged)?;
        let samples = reader.output_color_type().0.samples();
        let mut decoded = vec![0; width * height * samples];
        let color = reader.next_frame(&mut decoded).map_err(damaged)?.color_type;
        self.pixels.clear();
        match color {
            ColorType::Grayscale => self.pixels = decoded,
            ColorType::GrayscaleAlpha => self.pixels.extend(decoded.chunks_exact(samples).map(|pixel| pixel[0])),
            ColorType::Rgb | ColorType::Rgba => self.pixels.extend(decoded.chunks_exact(samples).map(luma)),
            // `EXPAND` leaves none.
            ColorType::Indexed => return Err(PictureError::Damaged("it has a palette still".to_owned())),
        }
        (self.width, self.height) = (width, height);
        Ok(())
    }

    /// Replaces it by the pixels that `input` begins with, and says how many bytes that were; it is empty if they are too few.
    /// The sides are at most [`MAX_SIDE`].
    pub(crate) fn read_pixels(&mut self, input: impl Read, width: usize, height: usize) -> std::io::Result<usize> {
        self.clear();
        self.pixels.clear();
        // Memory grows with what comes, not with what was announced.
        let read = input.take((width * height) as u64).read_to_end(&mut self.pixels)?;
        if read == width * height {
            (self.width, self.height) = (width, height);
        }
        Ok(read)
    }

    pub(crate) const fn clear(&mut self) {
        (self.width, self.height) = (0, 0);
    }

    /// Replaces it by the brightness of a JPEG picture. After an error it is empty.
    ///
    /// A picture without Huffman tables has the standard ones: many cameras and AVI files leave them out.
    pub fn decode_jpeg(&mut self, bytes: &[u8]) -> Result<(), PictureError> {
        self.clear();
        let bytes = with_huffman_tables(bytes);
        let options = DecoderOptions::default()
            .set_max_width(MAX_SIDE)
            .set_max_height(MAX_SIDE)
            .jpeg_set_out_colorspace(ColorSpace::Luma);
        let mut decoder = JpegDecoder::new_with_options(ZCursor::new(&*bytes), options);
        let damaged = |error: zune_jpeg::errors::DecodeErrors| PictureError::Damaged(error.to_string());
        decoder.decode_headers().map_err(damaged)?;
        let nothing = || PictureError::Damaged("it has no size".to_owned());
        let info = decoder.info().ok_or_else(nothing)?;
        let (width, height) = (usize::from(info.width), usize::from(info.height));
        if width.max(height) > MAX_SIDE {
            return Err(PictureError::TooLarge { width, height });
        }
        self.pixels.resize(decoder.output_buffer_size().ok_or_else(nothing)?, 0);
        decoder.decode_into(&mut self.pixels).map_err(damaged)?;
        (self.width, self.height) = (width, height);
        Ok(())
    }

    /// As PGM.
    pub fn to_pgm(&self) -> Vec<u8> {
        let header = format!("P5 {} {} 255\n", self.width, self.height);
        [header.as_bytes(), &self.pixels[..self.width * self.height]].concat()
    }

    /// As PNG, which browsers show.
    pub fn to_png(&self) -> Option<Vec<u8>> {
        let mut bytes = Vec::new();
        let mut encoder =
            png::Encoder::new(&mut bytes, u32::try_from(self.width).ok()?, u32::try_from(self.height).ok()?);
        encoder.set_color(ColorType::Grayscale);
        encoder.set_compression(png::Compression::Fastest);
        let mut writer = encoder.write_header().ok()?;
        writer.write_image_data(&self.pixels[..self.width * self.height]).ok()?;
        writer.finish().ok()?;
        Some(bytes)
    }

    /// `None` while it is empty.
    pub fn image(&self) -> Option<GreyImage<'_>> {
        GreyImage::new(&self.pixels, self.width, self.height, self.width).filter(|image| image.height() > 0)
    }
}

fn luma(pixel: &[u8]) -> u8 {
    let [red, green, blue] = [0, 1, 2].map(|index| u32::from(pixel[index]));
    ((19_595 * red + 38_470 * green + 7_471 * blue + 32_768) >> 16) as u8
}

/// The picture, with a mark that makes the decoder take the standard tables (ITU-T T.81, annex K.3) if it has none.
fn with_huffman_tables(jpeg: &[u8]) -> Cow<'_, [u8]> {
    /// The segment APP0 of a picture in an AVI file.
    const AVI_MARK: &[u8] = b"\xFF\xE0\0\x10AVI1\0\0\0\0\0\0\0\0\0\0";
    if has_huffman_tables(jpeg) {
        return Cow::Borrowed(jpeg);
    }
    let (start, rest) = jpeg.split_at(2.min(jpeg.len()));
    Cow::Owned([start, AVI_MARK, rest].concat())
}

/// False only if the first scan comes without any.
fn has_huffman_tables(jpeg: &[u8]) -> bool {
    let mut rest = jpeg.get(2..).unwrap_or_default();
    loop {
        match rest {
            [0xFF, 0xDA, ..] => return false,
            [0xFF, 0xFF, ..] => rest = &rest[1..],
            [0xFF, marker, high, low, ..] if *marker != 0xC4 => {
                let length = usize::from(u16::from_be_bytes([*high, *low]));
                rest = rest.get(2 + length..).unwrap_or_default();
            }
            _ => return true,
        }
    }
}
