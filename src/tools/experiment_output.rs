//! Output of a report: page, figures, and numbers as text or JSON.

use std::path::{Path, PathBuf};

use anyhow::Context;
use posebridge_report::page::ReportBlock;
use posebridge_report::report::Report;

use super::raster;
use crate::console::{colour, print_line, print_result};
use crate::exit::{ExitStage, Failure};

/// The flags that every experiment has.
#[derive(clap::Args, Clone, Debug, Default)]
pub struct OutputArgs {
    /// Folder for the page and the pictures. Default: the current folder.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Also write every picture as PNG; needs a program built with the feature `png`.
    #[arg(long)]
    pub png: bool,
    /// Print one JSON object instead of tables.
    #[arg(long)]
    pub json: bool,
}

impl OutputArgs {
    /// Creates the folder before an experiment that may take minutes.
    pub fn folder(&self) -> Result<PathBuf, Failure> {
        if self.png {
            raster::check().before_start()?;
        }
        let folder = self.out.clone().unwrap_or_else(|| PathBuf::from("."));
        std::fs::create_dir_all(&folder)
            .with_context(|| format!("making the folder `{}`", folder.display()))
            .before_start()?;
        Ok(folder)
    }

    /// Writes the page and its figures into `folder`, prints the numbers and the path of the page.
    ///
    /// The figures are named `<name>-<n>.svg`, counted from 1, or `<name>.svg` if there is one; those with a name of their own
    /// `<name>-<their name>.svg`.
    pub fn write_outcome(&self, folder: &Path, report: &Report) -> Result<(), Failure> {
        let (name, page) = (report.name(), report.page());
        let pictures: Vec<&String> = page.blocks.iter().filter_map(picture).collect();
        for (index, svg) in pictures.iter().enumerate() {
            let number = if pictures.len() > 1 { format!("-{}", index + 1) } else { String::new() };
            self.write_picture(folder, &format!("{name}{number}"), svg)?;
        }
        for block in &page.blocks {
            // Elements of the page.
            if let ReportBlock::FigureGrid(pictures) = block {
                for picture in pictures {
                    self.write_picture(folder, &format!("{name}-{}", picture.name), &picture.svg)?;
                }
            }
        }
        let path = folder.join(format!("{name}.html"));
        write(&path, page.html().as_bytes())?;
        let text = if self.json { format!("{}\n", report.json()) } else { report.text_in(colour()) };
        print_result(&text).while_running()?;
        print_line(&format!("page: {}", path.display()));
        Ok(())
    }

    fn write_picture(&self, folder: &Path, name: &str, svg: &str) -> Result<(), Failure> {
        write(&folder.join(format!("{name}.svg")), svg.as_bytes())?;
        if self.png {
            let png = raster::png(svg).with_context(|| format!("drawing `{name}.png`")).while_running()?;
            write(&folder.join(format!("{name}.png")), &png)?;
        }
        Ok(())
    }
}

const fn picture(part: &ReportBlock) -> Option<&String> {
    let ReportBlock::Figure { svg, .. } = part else {
        return None;
    };
    Some(svg)
}

fn write(path: &Path, content: &[u8]) -> Result<(), Failure> {
    std::fs::write(path, content).with_context(|| format!("writing `{}`", path.display())).while_running()
}
