//! Pictures of files and cameras as grey pixels: JPEG, and PGM (netpbm's P5).

use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

use crate::grey_image::GreyImage;

/// Longest side that is decoded, px: a camera of 16 megapixels.
const MAX_SIDE: usize = 4_928;

/// A picture that could not be decoded.
#[derive(Debug, thiserror::Error)]
pub enum PictureError {
    #[error("it is neither a JPEG nor a PGM picture")]
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
    /// Replaces it by a picture of either format. After an error it is empty.
    pub fn decode(&mut self, bytes: &[u8]) -> Result<(), PictureError> {
        match bytes {
            [0xFF, 0xD8, ..] => self.decode_jpeg(bytes),
            [b'P', b'5', rest @ ..] => self.decode_pgm(rest),
            _ => {
                (self.width, self.height) = (0, 0);
                Err(PictureError::OtherFormat)
            }
        }
    }

    /// What follows the magic number: width, height and the largest value in decimals, with comments between them, then a byte for each
    /// pixel.
    fn decode_pgm(&mut self, bytes: &[u8]) -> Result<(), PictureError> {
        (self.width, self.height) = (0, 0);
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

    /// Replaces it by the brightness of a JPEG picture. After an error it is empty.
    pub fn decode_jpeg(&mut self, bytes: &[u8]) -> Result<(), PictureError> {
        (self.width, self.height) = (0, 0);
        let options = DecoderOptions::default()
            .set_max_width(MAX_SIDE)
            .set_max_height(MAX_SIDE)
            .jpeg_set_out_colorspace(ColorSpace::Luma);
        let mut decoder = JpegDecoder::new_with_options(ZCursor::new(bytes), options);
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

    /// `None` while it is empty.
    pub fn image(&self) -> Option<GreyImage<'_>> {
        GreyImage::new(&self.pixels, self.width, self.height, self.width).filter(|image| image.height() > 0)
    }
}
