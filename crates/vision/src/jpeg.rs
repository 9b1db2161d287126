//! JPEG pictures as grey pixels.

use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

use crate::grey_image::GreyImage;

/// Longest side that is decoded, px: a camera of 16 megapixels.
const MAX_SIDE: usize = 4_928;

/// A picture that could not be decoded.
#[derive(Debug, thiserror::Error)]
pub enum JpegError {
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
    /// Replaces it by the brightness of a JPEG picture. After an error it is empty.
    pub fn decode_jpeg(&mut self, bytes: &[u8]) -> Result<(), JpegError> {
        (self.width, self.height) = (0, 0);
        let options = DecoderOptions::default()
            .set_max_width(MAX_SIDE)
            .set_max_height(MAX_SIDE)
            .jpeg_set_out_colorspace(ColorSpace::Luma);
        let mut decoder = JpegDecoder::new_with_options(ZCursor::new(bytes), options);
        let damaged = |error: zune_jpeg::errors::DecodeErrors| JpegError::Damaged(error.to_string());
        decoder.decode_headers().map_err(damaged)?;
        let nothing = || JpegError::Damaged("it has no size".to_owned());
        let info = decoder.info().ok_or_else(nothing)?;
        let (width, height) = (usize::from(info.width), usize::from(info.height));
        if width.max(height) > MAX_SIDE {
            return Err(JpegError::TooLarge { width, height });
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
