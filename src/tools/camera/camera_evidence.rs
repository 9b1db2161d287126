//! What pictures of the floor sheet, measured marks and a recorded drive say of a camera.

use std::path::Path;

use anyhow::{Context, Result, ensure};
use posebridge_vision::{
    FlatTag, FloorCalibration, LensKnowledge, SeenPoint, SheetPlacement, SheetTag, Tag36h11Detector,
};

use super::detect::{detect, read_picture};
use super::recorded_drive::RecordedDrive;
use crate::tools::csv_table::CsvTable;

/// How well people read the pixel of a mark.
const MARK_SIGMA_PX: f64 = 0.5;
/// With so few marks or fewer, those that are left fit too well to blame one.
const MIN_MARKS_TO_JUDGE: usize = 6;
/// Improvement of the fit without a mark that makes it suspect.
pub(super) const SUSPECT_RATIO: f64 = 3.0;

/// What is known of a camera.
#[derive(Default)]
pub(super) struct CameraEvidence {
    pub(super) size: (usize, usize),
    pub(super) points: Vec<SeenPoint>,
    pub(super) groups: Vec<PointGroup>,
    /// Of the robot, in the pictures of the drive.
    pub(super) tags: Vec<FlatTag>,
    pub(super) robot_tag: u32,
    pub(super) drive: Option<RecordedDrive>,
}

/// Points that are reported together.
pub(super) struct PointGroup {
    /// Picture, recording or table.
    pub(super) file: String,
    pub(super) name: String,
    pub(super) count: usize,
}

impl CameraEvidence {
    fn check_size(&mut self, name: &str, size: (usize, usize)) -> Result<()> {
        if self.size == (0, 0) {
            self.size = size;
        }
        ensure!(
            self.size == size,
            "`{name}` has {} x {} pixels, the picture before it {} x {}: calibrate each size by itself",
            size.0,
            size.1,
            self.size.0,
            self.size.1
        );
        Ok(())
    }

    pub(super) fn add_picture(
        &mut self,
        path: &Path,
        sheet: &[SheetTag],
        place: SheetPlacement,
        first: u16,
    ) -> Result<()> {
        let file = path.display().to_string();
        let (size, tags) = detect(path, &read_picture(path)?, &mut Tag36h11Detector::default())?;
        self.check_size(&file, size)?;
        let before = self.points.len();
        for seen in &tags {
            if let Some(printed) = sheet.iter().find(|printed| printed.id == seen.id) {
                let points = place.points(printed, &seen.corners, &seen.covariance);
                self.add_group(&file, format!("tag {}", seen.id), &points);
            }
        }
        ensure!(
            self.points.len() > before,
            "`{file}` shows no tag of the floor sheet ({first} to {}): `posebridge camera detect` says what it shows",
            usize::from(first) + sheet.len() - 1
        );
        Ok(())
    }

    pub(super) fn add_points(&mut self, path: &Path, size: Option<(usize, usize)>) -> Result<()> {
        let file = path.display().to_string();
        self.check_size(&file, size.context("--picture-px is missing")?)?;
        for (index, row) in CsvTable::read(path)?.rows().enumerate() {
            let (pixel, place_m) = ([row.number("u")?, row.number("v")?], [row.number("x_m")?, row.number("y_m")?]);
            let point = SeenPoint::on_floor(place_m, pixel, MARK_SIGMA_PX);
            self.add_group(&file, format!("point {}", index + 1), &[point]);
        }
        Ok(())
    }

    pub(super) fn add_drive(&mut self, drive: RecordedDrive, sheet: &[SheetTag], place: SheetPlacement) -> Result<()> {
        self.check_size(&drive.name, drive.size)?;
        for seen in drive.floor_tags()? {
            if let Some(printed) = sheet.iter().find(|printed| printed.id == seen.id) {
                let points = place.points(printed, &seen.corners.corners, &seen.corners.full_covariance());
                self.add_group(&drive.name, format!("tag {}", seen.id), &points);
            }
        }
        (self.robot_tag, self.tags) = drive.robot_tags()?;
        self.drive = Some(drive);
        Ok(())
    }

    /// The measured mark without which the others fit much better.
    pub(super) fn suspect_mark(&self, lens: LensKnowledge, with_all: &FloorCalibration) -> Option<&str> {
        let marks = self.groups.iter().filter(|group| group.count == 1).count();
        let mut from = 0;
        let mut found = None;
        for group in &self.groups {
            let own = from..from + group.count;
            from = own.end;
            if group.count > 1 || marks <= MIN_MARKS_TO_JUDGE {
                continue;
            }
            let mut others = self.points.clone();
            others.drain(own);
            let without = FloorCalibration::solve(&others, &self.tags, lens).ok();
            if let Some(rms_px) = without.map(|without| without.rms_px)
                && rms_px * SUSPECT_RATIO < with_all.rms_px
                && found.is_none_or(|(_, least)| rms_px < least)
            {
                found = Some((group.name.as_str(), rms_px));
            }
        }
        found.map(|(name, _)| name)
    }

    fn add_group(&mut self, file: &str, name: String, points: &[SeenPoint]) {
        self.groups.push(PointGroup { file: file.to_owned(), name, count: points.len() });
        self.points.extend_from_slice(points);
    }
}
