//! A writer for the subset of SVG that the figures need.
//!
//! Shapes in pixels, y downward, hundredths of a pixel. Text is escaped; a shape with a non-finite coordinate is omitted, so that no
//! viewer meets a "NaN". It knows nothing of metres, panels or runs.
//!
//! Source: W3C, Scalable Vector Graphics 1.1 (second edition).

use std::collections::BTreeSet;
use std::fmt;
use std::fmt::Write as _;

use crate::markup::Escaped;

pub(super) type PixelPoint = (f64, f64);

pub(super) const BACKGROUND: &str = "#FFFFFF";
pub(super) const FAINT_INK: &str = "#666666";

/// Size of the cell that a small dot fills.
const SPECK_RADIUS_PX: f64 = 1.6;
const FEW_SPECKS: usize = 400;
const LARGE_SPECK_RADIUS_PX: f64 = 2.6;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Rect {
    pub(super) left: f64,
    pub(super) top: f64,
    pub(super) width: f64,
    pub(super) height: f64,
}

impl Rect {
    pub(super) const fn right(&self) -> f64 {
        self.left + self.width
    }
    pub(super) const fn bottom(&self) -> f64 {
        self.top + self.height
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Stroke {
    pub(super) color: &'static str,
    width_px: f64,
    dashes: Option<&'static str>,
}

impl Stroke {
    pub(super) const fn solid(color: &'static str, width_px: f64) -> Self {
        Self { color, width_px, dashes: None }
    }
    pub(super) const fn dashed(color: &'static str, width_px: f64, dashes: &'static str) -> Self {
        Self { color, width_px, dashes: Some(dashes) }
    }
}

impl fmt::Display for Stroke {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { color, width_px, .. } = self;
        write!(f, r#"stroke="{color}" stroke-width="{width_px}""#)?;
        match self.dashes {
            Some(dashes) => write!(f, r#" stroke-dasharray="{dashes}""#),
            None => Ok(()),
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Anchor {
    Start,
    Middle,
    End,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct TextStyle {
    pub(super) size_px: f64,
    pub(super) color: &'static str,
    pub(super) anchor: Anchor,
    pub(super) weight: u16,
}

#[derive(Debug)]
pub(super) struct Svg {
    text: String,
    /// Width and height.
    size_px: (f64, f64),
    clips: usize,
}

impl Svg {
    /// An empty picture on white paper; screen readers read `title`.
    pub(super) fn new(width_px: f64, height_px: f64, title: &str) -> Self {
        let mut svg = Self { text: String::new(), size_px: (width_px, height_px), clips: 0 };
        let title = Escaped(title);
        svg.write(format_args!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width_px}\" height=\"{height_px}\" \
             viewBox=\"0 0 {width_px} {height_px}\" role=\"img\" \
             font-family=\"Helvetica, Arial, 'DejaVu Sans', sans-serif\">\n<title>{title}</title>\n\
             <rect width=\"{width_px}\" height=\"{height_px}\" fill=\"{BACKGROUND}\"/>\n"
        ));
        svg
    }

    pub(super) fn rect(&mut self, rect: &Rect, stroke: &Stroke) {
        let Rect { left, top, width, height } = rect;
        self.write(format_args!(
            "<rect x=\"{left:.2}\" y=\"{top:.2}\" width=\"{width:.2}\" height=\"{height:.2}\" fill=\"none\" {stroke}/>\n"
        ));
    }

    pub(super) fn line(&mut self, from: PixelPoint, to: PixelPoint, stroke: &Stroke) {
        self.polyline(&[from, to], stroke);
    }

    /// An open line; nothing for fewer than two points.
    pub(super) fn polyline(&mut self, points: &[PixelPoint], stroke: &Stroke) {
        if points.len() > 1 && points.iter().all(is_finite) {
            let points = PointList(points);
            self.write(format_args!(
                "<polyline points=\"{points}\" fill=\"none\" stroke-linejoin=\"round\" {stroke}/>\n"
            ));
        }
    }

    /// `opacity` of the fill, 0 to 1.
    pub(super) fn polygon(&mut self, points: &[PixelPoint], fill: &str, opacity: f64, stroke: Option<&Stroke>) {
        if points.len() > 2 && points.iter().all(is_finite) {
            let points = PointList(points);
            let outline = stroke.map(Stroke::to_string).unwrap_or_default();
            self.write(format_args!(
                "<polygon points=\"{points}\" fill=\"{fill}\" fill-opacity=\"{opacity}\" {outline}/>\n"
            ));
        }
    }

    pub(super) fn disc(&mut self, center: PixelPoint, radius_px: f64, fill: &str, stroke: Option<&Stroke>) {
        if is_finite(&center) {
            let outline = stroke.map(Stroke::to_string).unwrap_or_default();
            self.write(format_args!(
                "<circle cx=\"{:.2}\" cy=\"{:.2}\" r=\"{radius_px}\" fill=\"{fill}\" {outline}/>\n",
                center.0, center.1
            ));
        }
    }

    /// Many small dots: a dot fills a cell of [`SPECK_RADIUS_PX`], and cells above each other become one stroke, so that the size of
    /// the document is bounded by the number of cells.
    pub(super) fn specks(&mut self, points: &[PixelPoint], color: &str) {
        let cell = |px: f64| (px / SPECK_RADIUS_PX).floor() as i32;
        let cells: BTreeSet<(i32, i32)> =
            points.iter().filter(|point| is_finite(point)).map(|(x, y)| (cell(*x), cell(*y))).collect();
        if cells.is_empty() {
            return;
        }
        let middle = |cell: i32| (f64::from(cell) + 0.5) * SPECK_RADIUS_PX;
        let cells: Vec<(i32, i32)> = cells.into_iter().collect();
        let mut path = String::new();
        for run in cells.chunk_by(|a, b| a.0 == b.0 && a.1 + 1 == b.1) {
            if let (Some((x, top)), Some((_, bottom))) = (run.first(), run.last()) {
                let (x, top, bottom) = (middle(*x), middle(*top), middle(*bottom));
                // Writing to a String cannot fail.
                let _ = write!(path, "M{x:.1} {top:.1}V{bottom:.1}");
            }
        }
        self.write(format_args!(
            "<path d=\"{path}\" fill=\"none\" stroke=\"{color}\" stroke-width=\"{width}\" stroke-linecap=\"round\"/>\n",
            width = if cells.len() < FEW_SPECKS { LARGE_SPECK_RADIUS_PX } else { SPECK_RADIUS_PX },
        ));
    }

    pub(super) fn cross(&mut self, center: PixelPoint, half_size_px: f64, stroke: &Stroke) {
        let (x, y) = center;
        for slant in [half_size_px, -half_size_px] {
            self.line((x - half_size_px, y - slant), (x + half_size_px, y + slant), stroke);
        }
    }

    pub(super) fn text(&mut self, at: PixelPoint, style: &TextStyle, text: &str) {
        self.write_text(at, style, text, "");
    }

    /// Text from bottom to top, for the left axis.
    pub(super) fn upright_text(&mut self, at: PixelPoint, style: &TextStyle, text: &str) {
        let turn = format!(" transform=\"rotate(-90 {:.2} {:.2})\"", at.0, at.1);
        self.write_text(at, style, text, &turn);
    }

    /// Clips what `draw` draws to the rectangle; `id` names the group in the document.
    pub(super) fn clip(&mut self, rect: &Rect, id: &str, draw: impl FnOnce(&mut Self)) {
        self.clips += 1;
        let clip = self.clips;
        let Rect { left, top, width, height } = rect;
        self.write(format_args!(
            "<clipPath id=\"clip{clip}\"><rect x=\"{left:.2}\" y=\"{top:.2}\" width=\"{width:.2}\" height=\"{height:.2}\"/>\
             </clipPath>\n<g id=\"{id}\" clip-path=\"url(#clip{clip})\">\n"
        ));
        draw(self);
        self.write(format_args!("</g>\n"));
    }

    /// Ends the document, with a note about omitted values.
    pub(super) fn finish(mut self, dropped: usize) -> String {
        if dropped > 0 {
            let style = TextStyle { size_px: 12.0, color: FAINT_INK, anchor: Anchor::End, weight: 400 };
            let note = format!("left out: {dropped} values that are not finite or out of reach");
            self.text((self.size_px.0 - 20.0, self.size_px.1 - 8.0), &style, &note);
        }
        self.write(format_args!("</svg>\n"));
        self.text
    }

    fn write_text(&mut self, at: PixelPoint, style: &TextStyle, text: &str, turn: &str) {
        let anchor = match style.anchor {
            Anchor::Start => "start",
            Anchor::Middle => "middle",
            Anchor::End => "end",
        };
        let TextStyle { size_px, color, weight, .. } = style;
        let ((x, y), text) = (at, Escaped(text));
        self.write(format_args!(
            "<text x=\"{x:.2}\" y=\"{y:.2}\" font-size=\"{size_px}\" font-weight=\"{weight}\" fill=\"{color}\" \
             text-anchor=\"{anchor}\"{turn}>{text}</text>\n"
        ));
    }

    fn write(&mut self, arguments: fmt::Arguments<'_>) {
        self.text.push_str(&fmt::format(arguments));
    }
}

fn is_finite(point: &PixelPoint) -> bool {
    point.0.is_finite() && point.1.is_finite()
}

struct PointList<'a>(&'a [PixelPoint]);

impl fmt::Display for PointList<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (index, (x, y)) in self.0.iter().enumerate() {
            let separator = if index == 0 { "" } else { " " };
            write!(f, "{separator}{x:.2},{y:.2}")?;
        }
        Ok(())
    }
}

// A picture as a part of a page instead of a file of its own.
//
// Several pictures in one page share its names, so each gets a prefix of its own. What only files need is left out. Colours stay
// attributes, which a style sheet may replace.

/// Not needed inside a page, where a reader may take it for an address.
const NAMESPACE: &str = " xmlns=\"http://www.w3.org/2000/svg\"";

/// Converts an SVG document of these figures to an element of a page; `prefix` consists of letters, digits and hyphens, and is unique
/// on the page.
///
/// Text in a picture is escaped and contains no quotation mark: the replacements apply only to the figure's own markup.
pub fn inline(svg: &str, prefix: &str) -> String {
    svg.replacen(NAMESPACE, "", 1)
        .replace(" id=\"", &format!(" id=\"{prefix}-"))
        .replace("\"url(#", &format!("\"url(#{prefix}-"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chart::session::render_errors;

    #[test]
    fn a_shape_that_is_not_finite_is_not_written() {
        let mut svg = Svg::new(10.0, 10.0, "t");
        let stroke = Stroke::solid("#000000", 1.0);
        svg.polyline(&[(0.0, 0.0), (f64::NAN, 1.0)], &stroke);
        svg.disc((f64::INFINITY, 0.0), 2.0, "#000000", None);
        let text = svg.finish(0);
        assert!(!text.contains("polyline") && !text.contains("circle"), "{text}");
    }

    #[test]
    fn small_dots_in_one_cell_are_one_and_columns_of_them_a_stroke() {
        let draw = |points: &[PixelPoint]| {
            let mut svg = Svg::new(10.0, 10.0, "t");
            svg.specks(points, "#000000");
            svg.finish(0)
        };
        let one = draw(&[(2.0, 2.0), (2.1, 2.2), (f64::NAN, 1.0)]);
        assert!(one.contains("d=\"M2.4 2.4V2.4\""), "{one}");
        let column = draw(&[(2.0, 0.1), (2.0, 2.0), (2.0, 3.3), (2.0, 8.5)]);
        assert!(column.contains("d=\"M2.4 0.8V4.0M2.4 8.8V8.8\""), "{column}");
        assert!(!draw(&[]).contains("<path"));
    }

    #[test]
    fn names_are_the_pictures_own_and_no_text_is_changed() {
        let svg = inline(&render_errors(" id=\"x\" \"url(#y)\"", &[]), "run-1");
        assert!(!svg.contains("http"), "{svg}");
        assert!(svg.contains("<clipPath id=\"run-1-clip1\">") && svg.contains("\"url(#run-1-clip1)\""));
        assert!(svg.contains("<title> id=&quot;x&quot; &quot;url(#y)&quot;</title>"), "{svg}");
        let ids = svg.matches(" id=\"").count();
        assert_eq!(svg.matches(" id=\"run-1-").count(), ids);
    }
}
