//! Converts figures to pixels, for programs that do not show SVG.
//! Only with the feature `png`, and in tests: the rasteriser takes longer to build than most other crates. Its only font is embedded,
//! so that figures are the same on every computer.

use anyhow::Result;

/// Pixels per unit of the figure, so that small text is legible on paper and on a dense screen.
#[cfg(any(test, feature = "png"))]
const SCALE: f32 = 2.0;
/// Embedded, under the Ubuntu font licence.
#[cfg(any(test, feature = "png"))]
const FAMILY: &str = "Ubuntu";

pub fn check() -> Result<()> {
    #[cfg(not(feature = "png"))]
    anyhow::bail!(
        "this program was built without the feature `png`: build it with `cargo install --path . --features png`, or leave `--png` out and \
         use the SVG files"
    );
    #[cfg(feature = "png")]
    Ok(())
}

/// On a white background.
#[cfg(not(feature = "png"))]
pub fn png(_svg: &str) -> Result<Vec<u8>> {
    check().map(|()| Vec::new())
}

/// On a white background.
#[cfg(feature = "png")]
pub fn png(svg: &str) -> Result<Vec<u8>> {
    render(svg)
}

#[cfg(any(test, feature = "png"))]
fn render(svg: &str) -> Result<Vec<u8>> {
    use anyhow::Context as _;
    use resvg::tiny_skia::{Color, Pixmap, Transform};
    use resvg::usvg::{FontResolver, Options, Tree};

    let mut options = Options {
        font_family: FAMILY.to_owned(),
        font_resolver: FontResolver {
            // Figures ask for Helvetica and its like; there is one font.
            select_font: Box::new(|_, fonts| fonts.faces().next().map(|face| face.id)),
            ..FontResolver::default()
        },
        ..Options::default()
    };
    let font = epaint_default_fonts::UBUNTU_LIGHT.to_vec();
    options.fontdb_mut().load_font_data(font);
    let tree = Tree::from_str(svg, &options).context("reading the SVG")?;
    let size = tree.size().to_int_size().scale_by(SCALE).context("it has no size")?;
    let mut pixels = Pixmap::new(size.width(), size.height()).context("it is too large")?;
    pixels.fill(Color::WHITE);
    let transform = Transform::from_scale(SCALE, SCALE);
    resvg::render(&tree, transform, &mut pixels.as_mut());
    pixels.encode_png().context("packing it")
}

#[cfg(test)]
mod tests {
    #[test]
    fn a_picture_has_its_size_its_colours_and_its_letters() {
        let svg = |text: &str| {
            format!(
                "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"40\" height=\"20\" font-family=\"Helvetica, sans-serif\">\
                 <rect width=\"10\" height=\"20\" fill=\"#f00\"/><text x=\"14\" y=\"16\">{text}</text></svg>"
            )
        };
        let pixels = |text: &str| {
            let png = super::render(&svg(text)).expect("it is an SVG");
            resvg::tiny_skia::Pixmap::decode_png(&png).expect("it is a PNG")
        };
        let (blank, lettered) = (pixels(""), pixels("m"));
        assert_eq!((blank.width(), blank.height()), (80, 40));
        let colour = |x, y| blank.pixel(x, y).map(|pixel| (pixel.red(), pixel.green(), pixel.blue()));
        assert_eq!(colour(10, 20), Some((255, 0, 0)));
        assert_eq!(colour(60, 20), Some((255, 255, 255)));
        assert_ne!(blank, lettered, "letters are drawn");
    }

    #[test]
    fn what_is_no_picture_is_an_error() {
        assert!(super::render("<svg").is_err());
        assert!(super::render("").is_err());
    }

    #[cfg(not(feature = "png"))]
    #[test]
    fn a_program_without_it_says_how_to_get_it() {
        let error = super::check().expect_err("it cannot draw").to_string();
        assert!(error.contains("--features png"), "{error}");
        assert!(super::png("<svg/>").is_err());
    }
}
