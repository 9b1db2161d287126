//! What an experiment of the lab leaves behind: a page, its pictures, and numbers for people or programs.

use std::path::{Path, PathBuf};

use anyhow::Context;
use posebridge_report::page::{ReportBlock, ReportFigure, ReportPage};

use super::raster;
use crate::console::{print_line, print_result};
use crate::exit::{ExitStage, Failure};

/// The flags that every experiment has.
#[derive(clap::Args, Clone, Debug, Default)]
pub struct OutputArgs {
    /// Folder for the page and the pictures, instead of the current one.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Write every picture as PNG, too; needs a program built with the feature `png`.
    #[arg(long)]
    pub png: bool,
    /// Print one JSON object instead of tables.
    #[arg(long)]
    pub json: bool,
}

/// The result of an experiment.
#[derive(Clone, Debug)]
pub struct ExperimentOutcome {
    /// The command's words joined, such as `lab-wall`; names the files.
    pub name: &'static str,
    /// The page; its pictures are written beside it as well, as `<name>-<n>.svg`, counted from 1, or `<name>.svg` if there is
    /// one; those with a name of their own as `<name>-<their name>.svg`.
    pub page: ReportPage,
    /// Tables for the terminal, with a line feed at the end.
    pub text: String,
    /// The same for programs.
    pub json: serde_json::Value,
}

impl OutputArgs {
    /// Makes the folder, before minutes are spent on what could not be kept.
    ///
    /// # Errors
    /// It cannot be made, or this program cannot write what is asked for.
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

    /// Writes the files into `folder`, prints the numbers, and says where the page is.
    ///
    /// # Errors
    /// Something cannot be written.
    pub fn write_outcome(&self, folder: &Path, outcome: &ExperimentOutcome) -> Result<(), Failure> {
        let pictures: Vec<&String> = outcome.page.blocks.iter().filter_map(picture).collect();
        for (index, svg) in pictures.iter().enumerate() {
            let number = if pictures.len() > 1 { format!("-{}", index + 1) } else { String::new() };
            self.write_picture(folder, &format!("{}{number}", outcome.name), svg)?;
        }
        for picture in outcome.page.blocks.iter().flat_map(pictures_of) {
            let name = format!("{}-{}", outcome.name, picture.name);
            self.write_picture(folder, &name, &picture.svg)?;
        }
        let page = folder.join(format!("{}.html", outcome.name));
        write(&page, outcome.page.html().as_bytes())?;
        let text = if self.json { format!("{}\n", outcome.json) } else { outcome.text.clone() };
        print_result(&text).while_running()?;
        print_line(&format!("page: {}", page.display()));
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

/// Those that are elements of the page.
fn pictures_of(part: &ReportBlock) -> &[ReportFigure] {
    let ReportBlock::FigureGrid(pictures) = part else {
        return &[];
    };
    pictures
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
