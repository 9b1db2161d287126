//! `posebridge camera sheet`: pages of A4 with tags, as SVG and PDF.

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use clap::Args;
use pdf_writer::{Content, Finish as _, Name, Pdf, Rect, Ref, Str};
use posebridge_vision::{RULER_M, SHEET_SIZE_M, SheetTag, floor_sheet, robot_sheet, tag36h11_modules};

use crate::console::print_line;
use crate::exit::{ExitStage, Failure};

/// Flags of `camera sheet`.
#[derive(Args, Clone, Debug)]
pub struct SheetArgs {
    /// Number of the tag of each robot; tag36h11 has 0 to 586.
    #[arg(long, value_name = "ID", value_delimiter = ',', default_value = "0")]
    pub robots: Vec<u16>,
    /// Side of the black rim of the robots' tags, mm.
    #[arg(long, value_name = "MM", default_value_t = 80.0)]
    pub side_mm: f64,
    /// Number of the first of the four tags of the floor sheet.
    #[arg(long, value_name = "ID", default_value_t = 580)]
    pub floor_from: u16,
    /// Folder for `tags.pdf`, `floor.svg` and a `robot-ID.svg` for each robot.
    #[arg(long, value_name = "FOLDER", default_value = "tags")]
    pub out: PathBuf,
}

/// The ends of the ruler, from the lower left corner of the sheet, mm.
const RULER_MM: (f64, f64) = (55.0, 20.0);
const TICK_MM: f64 = 3.0;
/// The first line of text, and the distance of lines, mm.
const TEXT_MM: (f64, f64) = (15.0, 283.0);
const LINE_MM: f64 = 5.5;
const FONT_MM: f64 = 3.9;
const STROKE_MM: f64 = 0.2;
/// Points of PDF and millimetres.
const POINTS_PER_MM: f64 = 72.0 / 25.4;

/// What is printed on a page; the origin is the lower left corner, and y points up.
#[derive(Clone, Debug)]
struct Page {
    name: String,
    lines: Vec<String>,
    tags: Vec<SheetTag>,
}

pub(super) fn execute(args: &SheetArgs) -> Result<(), Failure> {
    let pages = pages(args).before_start()?;
    write(&pages, &args.out).before_start()?;
    print_line(&format!(
        "print `{}` at 100 %, and measure the line of {:.0} mm on the floor sheet: another length says that the printer has scaled",
        args.out.join("tags.pdf").display(),
        1e3 * RULER_M
    ));
    Ok(())
}

fn pages(args: &SheetArgs) -> Result<Vec<Page>> {
    let floor = floor_sheet(args.floor_from).with_context(|| {
        format!("--floor-from {}: four tags from there on are more than tag36h11 has (0 to 586)", args.floor_from)
    })?;
    let mut pages = vec![Page {
        name: "floor".to_owned(),
        lines: vec![
            "posebridge: tags for the floor (tag36h11). Lay the sheet flat where the camera sees it whole.".to_owned(),
            format!(
                "Its lower left corner is the origin, x runs along the short side, y along the long one. Sides {:.0} mm.",
                1e3 * floor[0].side_m
            ),
            format!("The line below is {:.0} mm long. Another length says that the printer has scaled.", 1e3 * RULER_M),
        ],
        tags: floor.clone(),
    }];
    for id in &args.robots {
        ensure!(
            floor.iter().all(|tag| tag.id != *id),
            "--robots {id}: this tag is on the floor sheet; choose another, or another --floor-from"
        );
        let tag = robot_sheet(*id, args.side_mm / 1e3).with_context(|| {
            format!("--robots {id} --side-mm {}: ids go from 0 to 586, sides to 150 mm", args.side_mm)
        })?;
        pages.push(Page {
            name: format!("robot-{id}"),
            lines: vec![
                format!("posebridge: tag {id} of tag36h11 for a robot. The black rim is {} mm wide.", args.side_mm),
                "Cut along the outer line, and keep the white around the rim. The arrow points where the robot drives."
                    .to_owned(),
            ],
            tags: vec![tag],
        });
    }
    Ok(pages)
}

fn write(pages: &[Page], folder: &Path) -> Result<()> {
    fs::create_dir_all(folder).with_context(|| format!("creating the folder `{}`", folder.display()))?;
    let file = |name: String, bytes: Vec<u8>| {
        let path = folder.join(name);
        fs::write(&path, bytes).with_context(|| format!("writing `{}`", path.display()))
    };
    for page in pages {
        file(format!("{}.svg", page.name), svg(page).into_bytes())?;
    }
    file("tags.pdf".to_owned(), pdf(pages))
}

/// A filled rectangle: left, bottom, width and height, mm.
type Bar = [f64; 4];

impl Page {
    /// The black modules of its tags, each row of neighbours as one.
    fn bars(&self) -> Vec<Bar> {
        let mut bars = Vec::new();
        for tag in &self.tags {
            let module = 1e3 * tag.side_m / 8.0;
            let modules = tag36h11_modules(tag.id).unwrap_or_default();
            // With the white around.
            let (left, top) = (1e3 * tag.middle_m.x - 5.0 * module, 1e3 * tag.middle_m.y + 5.0 * module);
            for (row, line) in modules.iter().enumerate() {
                let bottom = top - (row as f64 + 1.0) * module;
                let mut column = 0;
                for run in line.chunk_by(|one, other| one == other) {
                    if !run[0] {
                        bars.push([left + column as f64 * module, bottom, run.len() as f64 * module, module]);
                    }
                    column += run.len();
                }
            }
        }
        bars
    }

    /// Thin lines, as their ends: the ruler of the floor sheet; around a robot's tag where to cut, and its way up.
    fn strokes(&self) -> Vec<[(f64, f64); 2]> {
        let [tag] = self.tags.as_slice() else {
            let (left, y) = RULER_MM;
            let right = left + 1e3 * RULER_M;
            let tick = |x: f64| [(x, y - TICK_MM), (x, y + TICK_MM)];
            return vec![[(left, y), (right, y)], tick(left), tick(right)];
        };
        let (x, y, half) = (1e3 * tag.middle_m.x, 1e3 * tag.middle_m.y, 1e3 * tag.side_m * 5.0 / 8.0);
        let corners = [(x - half, y - half), (x + half, y - half), (x + half, y + half), (x - half, y + half)];
        let cut = (0..4).map(|corner| [corners[corner], corners[(corner + 1) % 4]]);
        let tip = (x, y + half + 20.0);
        let arrow = [(x, y + half + 5.0), (x - 4.0, tip.1 - 6.0), (x + 4.0, tip.1 - 6.0)].map(|from| [from, tip]);
        cut.chain(arrow).collect()
    }

    fn text(&self) -> impl Iterator<Item = (f64, &str)> {
        self.lines.iter().enumerate().map(|(index, line)| (TEXT_MM.1 - index as f64 * LINE_MM, line.as_str()))
    }
}

fn svg(page: &Page) -> String {
    let (width, height) = (1e3 * SHEET_SIZE_M.0, 1e3 * SHEET_SIZE_M.1);
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}mm\" height=\"{height}mm\" viewBox=\"0 0 {width} {height}\">\n<path d=\""
    );
    // Writing to a string cannot fail.
    for [left, bottom, width, bar_height] in page.bars() {
        let top = height - bottom - bar_height;
        write!(text, "M{left:.4} {top:.4}h{width:.4}v{bar_height:.4}h-{width:.4}z").unwrap_or_default();
    }
    write!(text, "\"/>\n<path fill=\"none\" stroke=\"black\" stroke-width=\"{STROKE_MM}\" d=\"").unwrap_or_default();
    for [from, to] in page.strokes() {
        write!(text, "M{:.3} {:.3}L{:.3} {:.3}", from.0, height - from.1, to.0, height - to.1).unwrap_or_default();
    }
    text.push_str("\"/>\n");
    for (y, line) in page.text() {
        let (x, y) = (TEXT_MM.0, height - y);
        writeln!(text, "<text x=\"{x}\" y=\"{y}\" font-family=\"sans-serif\" font-size=\"{FONT_MM}\">{line}</text>")
            .unwrap_or_default();
    }
    text + "</svg>\n"
}

fn pdf(pages: &[Page]) -> Vec<u8> {
    const FONT: Name<'_> = Name(b"F");
    let points = |mm: f64| (mm * POINTS_PER_MM) as f32;
    let (catalog, tree, font) = (Ref::new(1), Ref::new(2), Ref::new(3));
    let page_ids = |index: usize| (Ref::new(4 + 2 * index as i32), Ref::new(5 + 2 * index as i32));
    let mut pdf = Pdf::new();
    pdf.catalog(catalog).pages(tree);
    pdf.pages(tree).kids((0..pages.len()).map(|index| page_ids(index).0)).count(pages.len() as i32);
    pdf.type1_font(font).base_font(Name(b"Helvetica"));
    for (index, page) in pages.iter().enumerate() {
        let (page_id, content_id) = page_ids(index);
        let mut written = pdf.page(page_id);
        written.parent(tree).contents(content_id);
        written.media_box(Rect::new(0.0, 0.0, points(1e3 * SHEET_SIZE_M.0), points(1e3 * SHEET_SIZE_M.1)));
        written.resources().fonts().pair(FONT, font);
        written.finish();
        let mut content = Content::new();
        for bar in page.bars() {
            let [left, bottom, width, height] = bar.map(points);
            content.rect(left, bottom, width, height);
        }
        content.fill_nonzero();
        content.set_line_width(points(STROKE_MM));
        for [from, to] in page.strokes() {
            content.move_to(points(from.0), points(from.1)).line_to(points(to.0), points(to.1));
        }
        content.stroke();
        for (y, line) in page.text() {
            content.begin_text().set_font(FONT, points(FONT_MM)).next_line(points(TEXT_MM.0), points(y));
            content.show(Str(line.as_bytes())).end_text();
        }
        pdf.stream(content_id, &content.finish());
    }
    pdf.finish()
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_vision::{GreyImage, Tag36h11Detector, TagDetector as _};
    use resvg::tiny_skia::{Color, Pixmap, Transform};
    use resvg::usvg::{Options, Tree};

    const PIXELS_PER_MM: f64 = 4.0;

    fn usual() -> SheetArgs {
        SheetArgs { robots: vec![3, 7], side_mm: 80.0, floor_from: 580, out: PathBuf::new() }
    }

    /// The grey pixels of an SVG page, as a printer would see them.
    fn print(svg: &str) -> (Vec<u8>, usize, usize) {
        let tree = Tree::from_str(svg, &Options::default()).unwrap();
        let size = [SHEET_SIZE_M.0, SHEET_SIZE_M.1].map(|side_m| (1e3 * side_m * PIXELS_PER_MM) as u32);
        let mut pixels = Pixmap::new(size[0], size[1]).unwrap();
        pixels.fill(Color::WHITE);
        let scale = size[0] as f32 / tree.size().width();
        resvg::render(&tree, Transform::from_scale(scale, scale), &mut pixels.as_mut());
        (pixels.pixels().iter().map(|pixel| pixel.red()).collect(), size[0] as usize, size[1] as usize)
    }

    #[test]
    fn the_detector_finds_each_printed_tag_at_its_place_with_its_way_up() {
        let pages = pages(&usual()).unwrap();
        assert_eq!(pages.iter().map(|page| page.tags.len()).collect::<Vec<_>>(), [4, 1, 1]);
        for page in pages {
            let (pixels, width, height) = print(&svg(&page));
            let mut found = Tag36h11Detector::default().detect(GreyImage::new(&pixels, width, height, width).unwrap());
            found.sort_by_key(|tag| tag.id);
            assert_eq!(
                found.iter().map(|tag| tag.id).collect::<Vec<_>>(),
                page.tags.iter().map(|tag| tag.id).collect::<Vec<_>>()
            );
            for (found, tag) in found.iter().zip(&page.tags) {
                for (pixel, corner) in found.corners.iter().zip(tag.corners_m()) {
                    // The first pixel's centre is half a pixel from the edge of the paper.
                    let (x, y) = ((pixel.x + 0.5) / PIXELS_PER_MM, 297.0 - (pixel.y + 0.5) / PIXELS_PER_MM);
                    let away = (x - 1e3 * corner.x).hypot(y - 1e3 * corner.y);
                    assert!(away < 0.05, "tag {}: {away} mm", tag.id);
                }
            }
        }
    }

    #[test]
    fn the_pdf_has_the_same_bars() {
        let pages = pages(&usual()).unwrap();
        let pdf = pdf(&pages);
        assert!(pdf.starts_with(b"%PDF-"));
        let text = String::from_utf8_lossy(&pdf);
        let bars: usize = pages.iter().map(|page| page.bars().len()).sum();
        let rectangles: Vec<Vec<f64>> = text
            .lines()
            .filter_map(|line| line.strip_suffix(" re"))
            .map(|line| line.split(' ').map(|number| number.parse().unwrap()).collect())
            .collect();
        assert_eq!(rectangles.len(), bars);
        for (printed, bar) in rectangles.iter().zip(pages.iter().flat_map(Page::bars)) {
            for (printed, mm) in printed.iter().zip(bar) {
                assert!((printed / 72.0 * 25.4 - mm).abs() < 1e-3, "{printed} {mm}");
            }
        }
    }

    #[test]
    fn tags_that_there_are_not_are_refused() {
        for (args, words) in [
            (SheetArgs { floor_from: 584, ..usual() }, "--floor-from 584"),
            (SheetArgs { robots: vec![587], ..usual() }, "--robots 587"),
            (SheetArgs { side_mm: 151.0, ..usual() }, "--side-mm 151"),
            (SheetArgs { robots: vec![583], ..usual() }, "--robots 583: this tag is on the floor sheet"),
        ] {
            let error = pages(&args).unwrap_err().to_string();
            assert!(error.contains(words), "{error}");
        }
    }
}
