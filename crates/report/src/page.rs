//! The result of an experiment as one self-contained HTML file: no server, script, font or network.
//!
//! Pictures are embedded as images, or as elements of the page with prefixed ids, so that the ids of two of them cannot collide.
//!
//! ```
//! use posebridge_report::page::{ReportBlock, ReportPage};
//! let page = ReportPage {
//!     title: "Step response".to_owned(),
//!     blocks: vec![ReportBlock::Text("How slow is the sensor?".to_owned())],
//! };
//! assert!(page.html().contains("<h1>Step response</h1>"));
//! ```

use std::fmt;

use super::chart::inline;
use super::markup::{Escaped, PercentEncoded};
use super::metrics::VerdictTone;

/// Prints like the screen; follows the reader's light or dark mode; one column on a phone.
///
/// The colours of embedded pictures are attributes for white paper, which the dark rules replace one by one: each keeps its hue and
/// stays distinguishable for colour-blind readers.
const STYLE: &str = concat!(
    ":root{color-scheme:light dark;--ink:#222;--faint:#666;--paper:#fff;--line:#ddd;--block:#f5f5f5;",
    "--good:#00694c;--open:#555;--bad:#a84300}\n",
    "body{font:16px/1.5 Helvetica,Arial,'DejaVu Sans',sans-serif;color:var(--ink);background:var(--paper);",
    "max-width:1120px;margin:2em auto;padding:0 1em}\n",
    "p,ul,pre,table{max-width:920px}h1,h2,h3,p,li,.text td{overflow-wrap:anywhere}h2{margin-top:2em}\n",
    "table{border-collapse:collapse;margin:1em 0}.wide{overflow-x:auto}",
    "th,td{padding:.25em .8em;border-bottom:1px solid var(--line);text-align:right;vertical-align:top}",
    "th:first-child,td:first-child,.text th,.text td{text-align:left}\n",
    "figure{margin:1em 0}img{max-width:100%}figcaption{color:var(--faint);font-size:.9em}\n",
    ".pictures{display:grid;grid-template-columns:repeat(auto-fill,minmax(min(100%,480px),1fr));gap:1em 1.5em;align-items:start}\n",
    ".pictures figure{margin:0;min-width:0}.pictures svg{width:100%;height:auto;max-width:640px;display:block}\n",
    "pre{background:var(--block);padding:.7em;overflow-x:auto}\n",
    ".good,.open,.bad{border-left:5px solid;padding:.1em 0 .1em .8em;max-width:905px}",
    ".good{border-color:var(--good)}.open{border-color:var(--open)}.bad{border-color:var(--bad)}",
    ".good b{color:var(--good)}.open b{color:var(--open)}.bad b{color:var(--bad)}\n",
    "@media (max-width:600px){body{margin:1em auto;font-size:15px}th,td{padding:.2em .45em}}\n",
    "@media print{body{margin:0;max-width:none}figure,tr{break-inside:avoid}h2,h3{break-after:avoid}",
    ".pictures{grid-template-columns:1fr 1fr}}\n",
    "@media screen and (prefers-color-scheme:dark){:root{--ink:#ddd;--faint:#999;--paper:#161616;--line:#3a3a3a;--block:#242424;",
    "--good:#3fcf9f;--open:#aaa;--bad:#ff9955}\n",
    "svg [fill='#FFFFFF']{fill:#161616}svg [fill='#222222'],svg [fill='#000000']{fill:#ddd}svg [fill='#666666']{fill:#999}",
    "svg [stroke='#222222'],svg [stroke='#000000']{stroke:#ddd}svg [stroke='#666666']{stroke:#999}",
    "svg [stroke='#E6E6E6']{stroke:#333}svg [stroke='#888888']{stroke:#777}\n",
    "svg [stroke='#0072B2']{stroke:#4aa8e8}svg [fill='#0072B2']{fill:#4aa8e8}",
    "svg [stroke='#D55E00']{stroke:#ff7f2a}svg [fill='#D55E00']{fill:#ff7f2a}",
    "svg [stroke='#009E73']{stroke:#20c997}svg [fill='#009E73']{fill:#20c997}}",
);

/// An HTML page as a list of blocks.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ReportPage {
    pub title: String,
    pub blocks: Vec<ReportBlock>,
}

/// A part of a page. All text is plain; markup in it is escaped.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ReportBlock {
    Heading(String),
    Text(String),
    /// Keeps line breaks and spaces: a command, a formula.
    PreformattedText(String),
    List(Vec<String>),
    /// A title below a [`Self::Heading`].
    Subheading(String),
    /// A rating in a word, with its reason.
    Verdict {
        tone: VerdictTone,
        word: String,
        text: String,
    },
    /// Pictures side by side where they fit, as elements of the page: they follow its colours.
    FigureGrid(Vec<ReportFigure>),
    /// Rows of text under a header.
    CodeTable {
        header: Vec<String>,
        /// A row may be shorter than the header.
        rows: Vec<Vec<String>>,
    },
    /// Rows under a header; the first column is left-aligned, the others right-aligned.
    Table {
        header: Vec<String>,
        rows: Vec<Vec<String>>,
    },
    Figure {
        svg: String,
        caption: String,
    },
}

/// A picture with a name.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ReportFigure {
    /// Letters, digits and hyphens; unique on a page. Also the name of the picture's file.
    pub name: String,
    pub svg: String,
    pub caption: String,
}

impl ReportBlock {
    pub fn table(header: &[&str], rows: Vec<Vec<String>>) -> Self {
        Self::Table { header: header.iter().map(|name| (*name).to_owned()).collect(), rows }
    }
}

impl ReportPage {
    pub fn html(&self) -> String {
        self.to_string()
    }
}

impl fmt::Display for ReportPage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let title = Escaped(&self.title);
        writeln!(f, "<!DOCTYPE html>\n<html lang=\"en\">\n<head>")?;
        writeln!(f, "<meta charset=\"utf-8\"/>\n<title>{title}</title>")?;
        writeln!(f, "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\"/>")?;
        writeln!(f, "<style>{STYLE}</style>\n</head>\n<body>\n<h1>{title}</h1>")?;
        self.blocks.iter().try_for_each(|part| write_block(f, part))?;
        writeln!(f, "</body>\n</html>")
    }
}

fn write_block(html: &mut fmt::Formatter<'_>, part: &ReportBlock) -> fmt::Result {
    match part {
        ReportBlock::Heading(text) => writeln!(html, "<h2>{}</h2>", Escaped(text)),
        ReportBlock::Text(text) => writeln!(html, "<p>{}</p>", Escaped(text)),
        ReportBlock::PreformattedText(text) => {
            let lines: Vec<String> = text.lines().map(|line| Escaped(line).to_string()).collect();
            writeln!(html, "<pre>{}</pre>", lines.join("\n"))
        }
        ReportBlock::List(points) => {
            let points = points.iter().map(|point| format!("<li>{}</li>", Escaped(point)));
            writeln!(html, "<ul>\n{}\n</ul>", points.collect::<Vec<_>>().join("\n"))
        }
        ReportBlock::Subheading(text) => writeln!(html, "<h3>{}</h3>", Escaped(text)),
        ReportBlock::Verdict { tone, word, text } => {
            let (word, text) = (Escaped(word), Escaped(text));
            let class = css_class(*tone);
            writeln!(html, "<p class=\"{class}\"><b>{word}</b> {text}</p>")
        }
        ReportBlock::FigureGrid(pictures) => write_figures(html, pictures),
        ReportBlock::CodeTable { header, rows } => write_table(html, "wide text", header, rows),
        ReportBlock::Table { header, rows } => write_table(html, "wide", header, rows),
        ReportBlock::Figure { svg, caption } => {
            let (data, caption) = (PercentEncoded(svg), Escaped(caption));
            writeln!(
                html,
                "<figure><img alt=\"{caption}\" src=\"data:image/svg+xml,{data}\"><figcaption>{caption}</figcaption></figure>"
            )
        }
    }
}

fn write_table(html: &mut fmt::Formatter<'_>, class: &str, header: &[String], rows: &[Vec<String>]) -> fmt::Result {
    let header = row(header, "th");
    writeln!(html, "<div class=\"{class}\"><table>\n<thead>{header}</thead>\n<tbody>")?;
    for cells in rows {
        writeln!(html, "{}", row(cells, "td"))?;
    }
    writeln!(html, "</tbody>\n</table></div>")
}

fn write_figures(html: &mut fmt::Formatter<'_>, pictures: &[ReportFigure]) -> fmt::Result {
    writeln!(html, "<div class=\"pictures\">")?;
    for picture in pictures {
        let (svg, caption) = (inline(&picture.svg, &picture.name), Escaped(&picture.caption));
        writeln!(html, "<figure>{svg}<figcaption>{caption}</figcaption></figure>")?;
    }
    writeln!(html, "</div>")
}

const fn css_class(tone: VerdictTone) -> &'static str {
    match tone {
        VerdictTone::Good => "good",
        VerdictTone::Inconclusive => "open",
        VerdictTone::Bad => "bad",
    }
}

fn row(cells: &[String], tag: &str) -> String {
    let cells = cells.iter().map(|cell| format!("<{tag}>{}</{tag}>", Escaped(cell)));
    format!("<tr>{}</tr>", cells.collect::<String>())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_holds_its_parts_in_order_and_no_foreign_markup() {
        let page = ReportPage {
            title: "a & b".to_owned(),
            blocks: vec![
                ReportBlock::Heading("<script>".to_owned()),
                ReportBlock::PreformattedText("x = 1\n  y < 2".to_owned()),
                ReportBlock::List(vec!["one".to_owned(), "two".to_owned()]),
                ReportBlock::Verdict { tone: VerdictTone::Bad, word: "no".to_owned(), text: "a < b".to_owned() },
                ReportBlock::FigureGrid(vec![ReportFigure {
                    name: "p1".to_owned(),
                    svg: "<svg><g id=\"a\"/></svg>".to_owned(),
                    caption: "<i>".to_owned(),
                }]),
                ReportBlock::table(&["k", "v"], vec![vec!["q".to_owned(), "\"3\"".to_owned()]]),
                ReportBlock::Figure { svg: "<svg id=\"1\"/>".to_owned(), caption: "what \"it\" is".to_owned() },
            ],
        };
        let html = page.html();
        let expected = [
            "<h1>a &amp; b</h1>",
            "<h2>&lt;script&gt;</h2>",
            "<pre>x = 1\n  y &lt; 2</pre>",
            "<li>one</li>\n<li>two</li>",
            "<p class=\"bad\"><b>no</b> a &lt; b</p>",
            "<figure><svg><g id=\"p1-a\"/></svg><figcaption>&lt;i&gt;</figcaption></figure>",
            "<thead><tr><th>k</th><th>v</th></tr></thead>",
            "<tr><td>q</td><td>&quot;3&quot;</td></tr>",
            "<img alt=\"what &quot;it&quot; is\" src=\"data:image/svg+xml,%3Csvg%20id=%221%22/%3E\">",
        ];
        let mut rest = html.as_str();
        for part in expected {
            let at = rest.find(part);
            assert!(at.is_some(), "{part} in {rest}");
            rest = &rest[at.unwrap() + part.len()..];
        }
    }
}
