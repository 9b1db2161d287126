//! Pictures as PNG, for slides and programs that show no SVG.
//!
//! The letters come with the program (`assets/dejavu`), and no others are used: the same picture gives the same bytes on every computer,
//! whatever fonts it has.

use std::sync::Arc;

use resvg::tiny_skia::{Pixmap, Transform};
use resvg::usvg::{Options, Tree, fontdb};

/// Dots per unit of the picture: two keep letters of 11 units readable when a page is printed, at some 190 dots per inch.
const DOTS_PER_UNIT: f32 = 2.0;
/// A larger picture would take more than 400 MB of memory; ours have up to a thousand units.
const MOST_DOTS: f32 = 10_000.0;
/// The only family that there is.
const FAMILY: &str = "DejaVu Sans";
const REGULAR: &[u8] = include_bytes!("../assets/dejavu/DejaVuSans.ttf");
const BOLD: &[u8] = include_bytes!("../assets/dejavu/DejaVuSans-Bold.ttf");

/// Why a picture could not be made of dots.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RasterError {
    /// The text is no picture.
    #[error("this is no SVG picture: {0}")]
    Unreadable(#[from] resvg::usvg::Error),
    /// It has no size, or is larger than anybody can look at.
    #[error(
        "a picture of {width} by {height} dots cannot be made; each side must have 1 to {MOST_DOTS}"
    )]
    Size {
        /// Wanted width, dots.
        width: f32,
        /// Wanted height, dots.
        height: f32,
    },
    /// The dots could not be packed.
    #[error("packing the dots as PNG: {0}")]
    Unpackable(String),
}

/// Draws pictures with the letters that the program brings.
#[derive(Debug)]
pub struct Rasteriser {
    options: Options<'static>,
}

impl Default for Rasteriser {
    fn default() -> Self {
        let mut fonts = fontdb::Database::new();
        for font in [REGULAR, BOLD] {
            fonts.load_font_source(fontdb::Source::Binary(Arc::new(font)));
        }
        fonts.set_sans_serif_family(FAMILY);
        Self {
            options: Options {
                font_family: FAMILY.to_owned(),
                fontdb: Arc::new(fonts),
                ..Options::default()
            },
        }
    }
}

impl Rasteriser {
    /// The PNG file of an SVG picture, two dots per unit, eight bits each of red, green, blue and opacity.
    ///
    /// # Errors
    /// The text is no SVG picture, or one without a size or with an enormous one.
    pub fn png(&self, svg: &str) -> Result<Vec<u8>, RasterError> {
        let tree = Tree::from_str(svg, &self.options)?;
        let (width, height) = (
            (tree.size().width() * DOTS_PER_UNIT).ceil(),
            (tree.size().height() * DOTS_PER_UNIT).ceil(),
        );
        let is_possible = width <= MOST_DOTS && height <= MOST_DOTS;
        let dots = is_possible.then(|| Pixmap::new(width as u32, height as u32));
        let Some(mut dots) = dots.flatten() else {
            return Err(RasterError::Size { width, height });
        };
        let enlarged = Transform::from_scale(DOTS_PER_UNIT, DOTS_PER_UNIT);
        resvg::render(&tree, enlarged, &mut dots.as_mut());
        dots.encode_png()
            .map_err(|error| RasterError::Unpackable(error.to_string()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of a picture of 40 by 20 units with a text or none: how many of its dots are dark.
    fn dark_dots(text: &str) -> usize {
        let svg = format!(
            "<svg xmlns='http://www.w3.org/2000/svg' width='40' height='20' font-family=\"Helvetica, Arial, 'DejaVu Sans', sans-serif\">\
             <rect width='40' height='20' fill='#ffffff'/><text x='2' y='15' font-size='14' fill='#000000'>{text}</text></svg>"
        );
        let png = Rasteriser::default().png(&svg).unwrap();
        let dots = Pixmap::decode_png(&png).unwrap();
        assert_eq!((dots.width(), dots.height()), (80, 40));
        dots.pixels().iter().filter(|dot| dot.red() < 128).count()
    }

    #[test]
    fn letters_are_drawn_with_the_fonts_that_come_along() {
        assert_eq!(dark_dots(""), 0);
        let (dot, word) = (dark_dots("."), dark_dots("σ mm"));
        assert!((4..40).contains(&dot), "{dot}");
        assert!((200..900).contains(&word), "{word}");
    }

    #[test]
    fn bold_letters_are_darker() {
        let bold = dark_dots("<tspan font-weight='700'>mm</tspan>");
        let plain = dark_dots("mm");
        assert!(5 * bold > 6 * plain, "{bold} {plain}");
    }

    #[test]
    fn what_is_no_picture_or_enormous_is_refused() {
        let rasteriser = Rasteriser::default();
        let refused = |svg: &str| rasteriser.png(svg).unwrap_err().to_string();
        assert!(refused("no picture").contains("this is no SVG picture"));
        let large = "<svg xmlns='http://www.w3.org/2000/svg' width='6000' height='10'/>";
        assert!(refused(large).contains("12000 by 20 dots"));
    }
}
