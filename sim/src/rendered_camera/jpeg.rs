//! Grey pictures as JPEG.

use jpeg_encoder::{ColorType, Encoder};

/// Encodes a picture in rows at a quality of 1 to 100. `None` if the pixels are not those of such a picture.
pub fn encode_jpeg(pixels: &[u8], width: u16, height: u16, quality: u8) -> Option<Vec<u8>> {
    if pixels.len() != usize::from(width) * usize::from(height) {
        return None;
    }
    let mut jpeg = Vec::with_capacity(pixels.len() / 4);
    Encoder::new(&mut jpeg, quality).encode(pixels, width, height, ColorType::Luma).ok()?;
    Some(jpeg)
}
