//! The result of an experiment as one HTML file that needs nothing else: no server, no script, no font, no network.
//!
//! Pictures are embedded as images of their own, so that the names inside two of them cannot meet.
//!
//! ```
//! use posebridge_analysis::report::page::{Page, Part};
//! let page = Page {
//!     title: "Step response".to_owned(),
//!     parts: vec![Part::Text("How slow is the sensor?".to_owned())],
//! };
//! assert!(page.html().contains("<h1>Step response</h1>"));
//! ```

use std::fmt;

use crate::markup::{Escaped, PercentEncoded};

/// Looks the same on paper.
const STYLE: &str = "body{font:16px/1.5 Helvetica,Arial,'DejaVu Sans',sans-serif;color:#222;max-width:920px;margin:2em auto;padding:0 1em}\
table{border-collapse:collapse;margin:1em 0}th,td{padding:.25em .8em;border-bottom:1px solid #ddd;text-align:right}\
th:first-child,td:first-child{text-align:left}figure{margin:1.5em 0}img{max-width:100%}figcaption{color:#666}\
pre{background:#f5f5f5;padding:.7em;overflow-x:auto}";

/// A page.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Page {
    /// Its headline.
    pub title: String,
    /// What stands below, in order.
    pub parts: Vec<Part>,
}

/// A part of a page. All text is plain; markup in it is shown as it is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Part {
    /// A headline within the page.
    Heading(String),
    /// A paragraph.
    Text(String),
    /// Lines that keep their breaks and blanks: a command, a formula.
    Lines(String),
    /// Points.
    List(Vec<String>),
    /// Rows under a header; the first column is to the left, all others to the right.
    Table {
        /// The names of the columns.
        header: Vec<String>,
        /// A row may be shorter than the header.
        rows: Vec<Vec<String>>,
    },
    /// A picture.
    Figure {
        /// A whole SVG document.
        svg: String,
        /// What is to be seen.
        caption: String,
    },
}

impl Part {
    /// A table of these columns.
    pub fn table(header: &[&str], rows: Vec<Vec<String>>) -> Self {
        Self::Table {
            header: header.iter().map(|name| (*name).to_owned()).collect(),
            rows,
        }
    }
}

impl Page {
    /// The whole document.
    #[must_use]
    pub fn html(&self) -> String {
        self.to_string()
    }
}

impl fmt::Display for Page {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let title = Escaped(&self.title);
        writeln!(f, "<!DOCTYPE html>\n<html lang=\"en\">\n<head>")?;
        writeln!(f, "<meta charset=\"utf-8\">\n<title>{title}</title>")?;
        writeln!(
            f,
            "<style>{STYLE}</style>\n</head>\n<body>\n<h1>{title}</h1>"
        )?;
        self.parts.iter().try_for_each(|part| write_part(f, part))?;
        writeln!(f, "</body>\n</html>")
    }
}

fn write_part(html: &mut fmt::Formatter<'_>, part: &Part) -> fmt::Result {
    match part {
        Part::Heading(text) => writeln!(html, "<h2>{}</h2>", Escaped(text)),
        Part::Text(text) => writeln!(html, "<p>{}</p>", Escaped(text)),
        Part::Lines(text) => {
            let lines: Vec<String> = text.lines().map(|line| Escaped(line).to_string()).collect();
            writeln!(html, "<pre>{}</pre>", lines.join("\n"))
        }
        Part::List(points) => {
            let points = points
                .iter()
                .map(|point| format!("<li>{}</li>", Escaped(point)));
            writeln!(
                html,
                "<ul>\n{}\n</ul>",
                points.collect::<Vec<_>>().join("\n")
            )
        }
        Part::Table { header, rows } => {
            writeln!(
                html,
                "<table>\n<thead>{}</thead>\n<tbody>",
                row(header, "th")
            )?;
            for cells in rows {
                writeln!(html, "{}", row(cells, "td"))?;
            }
            writeln!(html, "</tbody>\n</table>")
        }
        Part::Figure { svg, caption } => {
            let (data, caption) = (PercentEncoded(svg), Escaped(caption));
            writeln!(
                html,
                "<figure><img alt=\"{caption}\" src=\"data:image/svg+xml,{data}\"><figcaption>{caption}</figcaption></figure>"
            )
        }
    }
}

fn row(cells: &[String], tag: &str) -> String {
    let cells = cells
        .iter()
        .map(|cell| format!("<{tag}>{}</{tag}>", Escaped(cell)));
    format!("<tr>{}</tr>", cells.collect::<String>())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_holds_its_parts_in_order_and_no_foreign_markup() {
        let page = Page {
            title: "a & b".to_owned(),
            parts: vec![
                Part::Heading("<script>".to_owned()),
                Part::Lines("x = 1\n  y < 2".to_owned()),
                Part::List(vec!["one".to_owned(), "two".to_owned()]),
                Part::table(&["k", "v"], vec![vec!["q".to_owned(), "\"3\"".to_owned()]]),
                Part::Figure {
                    svg: "<svg id=\"1\"/>".to_owned(),
                    caption: "what \"it\" is".to_owned(),
                },
            ],
        };
        let html = page.html();
        let pieces = [
            "<h1>a &amp; b</h1>",
            "<h2>&lt;script&gt;</h2>",
            "<pre>x = 1\n  y &lt; 2</pre>",
            "<li>one</li>\n<li>two</li>",
            "<thead><tr><th>k</th><th>v</th></tr></thead>",
            "<tr><td>q</td><td>&quot;3&quot;</td></tr>",
            "<img alt=\"what &quot;it&quot; is\" src=\"data:image/svg+xml,%3Csvg%20id=%221%22/%3E\">",
        ];
        let mut rest = html.as_str();
        for piece in pieces {
            let at = rest.find(piece);
            assert!(at.is_some(), "{piece} in {rest}");
            rest = &rest[at.unwrap() + piece.len()..];
        }
    }
}
