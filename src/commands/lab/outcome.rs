//! What an experiment of the lab leaves behind: a page, its pictures, and numbers for people or programs.

use std::path::{Path, PathBuf};

use anyhow::Context;
use posebridge_analysis::report::page::{Page, Part, Picture};

use crate::commands::{Failure, Stage};
use crate::stderr::say;
use crate::stdout;

/// The flags that every experiment has.
#[derive(clap::Args, Clone, Debug, Default)]
pub struct OutputArgs {
    /// Folder for the page and the pictures, instead of the current one.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print one JSON object instead of tables.
    #[arg(long)]
    pub json: bool,
    /// Write every picture as PNG as well.
    #[cfg(feature = "png")]
    #[arg(long)]
    pub png: bool,
}

/// The result of an experiment.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// The command's words joined, such as `lab-wall`; names the files.
    pub name: &'static str,
    /// The page; its pictures are written beside it as well, as `<name>-<n>.svg`, counted from 1, or `<name>.svg` if there is
    /// one; those with a name of their own as `<name>-<their name>.svg`.
    pub page: Page,
    /// Tables for the terminal, with a line feed at the end.
    pub text: String,
    /// The same for programs.
    pub json: serde_json::Value,
}

impl OutputArgs {
    /// Makes the folder, before minutes are spent on what could not be kept.
    ///
    /// # Errors
    /// It cannot be made.
    pub fn folder(&self) -> Result<PathBuf, Failure> {
        let folder = self.out.clone().unwrap_or_else(|| PathBuf::from("."));
        std::fs::create_dir_all(&folder)
            .with_context(|| format!("making the folder `{}`", folder.display()))
            .at_start()?;
        Ok(folder)
    }

    /// Writes the files into `folder`, prints the numbers, and says where the page is.
    ///
    /// # Errors
    /// Something cannot be written.
    pub fn deliver(&self, folder: &Path, outcome: &Outcome) -> Result<(), Failure> {
        let pictures = outcome.pictures();
        for (name, svg) in &pictures {
            write(&folder.join(format!("{name}.svg")), svg.as_bytes())?;
        }
        #[cfg(feature = "png")]
        if self.png {
            write_as_png(folder, &pictures)?;
        }
        let page = folder.join(format!("{}.html", outcome.name));
        write(&page, outcome.page.html().as_bytes())?;
        let text = if self.json {
            format!("{}\n", outcome.json)
        } else {
            outcome.text.clone()
        };
        stdout::print(&text).while_running()?;
        say(&format!("page: {}", page.display()));
        Ok(())
    }
}

impl Outcome {
    /// The pictures, each with the name of its file without the ending.
    fn pictures(&self) -> Vec<(String, &String)> {
        let parts = &self.page.parts;
        let numbered: Vec<&String> = parts.iter().filter_map(picture).collect();
        let is_alone = numbered.len() == 1;
        let numbered = numbered.into_iter().enumerate().map(|(index, svg)| {
            let name = if is_alone {
                self.name.to_owned()
            } else {
                format!("{}-{}", self.name, index + 1)
            };
            (name, svg)
        });
        let named = parts.iter().flat_map(pictures_of);
        let named = named.map(|one| (format!("{}-{}", self.name, one.name), &one.svg));
        numbered.chain(named).collect()
    }
}

#[cfg(feature = "png")]
fn write_as_png(folder: &Path, pictures: &[(String, &String)]) -> Result<(), Failure> {
    let rasteriser = posebridge_analysis::raster::Rasteriser::default();
    for (name, svg) in pictures {
        let path = folder.join(format!("{name}.png"));
        let png = rasteriser
            .png(svg)
            .with_context(|| format!("drawing `{}`", path.display()))
            .while_running()?;
        write(&path, &png)?;
    }
    Ok(())
}

/// Those that are elements of the page.
fn pictures_of(part: &Part) -> &[Picture] {
    let Part::Pictures(pictures) = part else {
        return &[];
    };
    pictures
}

const fn picture(part: &Part) -> Option<&String> {
    let Part::Figure { svg, .. } = part else {
        return None;
    };
    Some(svg)
}

fn write(path: &Path, bytes: &[u8]) -> Result<(), Failure> {
    std::fs::write(path, bytes)
        .with_context(|| format!("writing `{}`", path.display()))
        .while_running()
}
