//! Tags to print: a sheet for the floor, whose tags have known places on it, and sheets for robots.

use nalgebra::{Isometry2, Matrix2, Point2, Point3, Vector2};

use crate::floor_calibration::SeenPoint;
use crate::tag_detector::DetectedTag;

/// A4, m.
pub const SHEET_SIZE_M: (f64, f64) = (0.210, 0.297);
/// Length of the line that shows whether the printer has scaled, m.
pub const RULER_M: f64 = 0.1;
/// Tags of a floor sheet.
pub const FLOOR_TAGS: u16 = 6;
/// Their sides, and the distances of their middles along the sheet's short and long side, m.
const FLOOR_SIDE_M: f64 = 0.05;
const FLOOR_SPACING_M: (f64, f64) = (0.1, 0.085);
/// The middle of the first one on the sheet, from its lower left corner, m.
const FIRST_M: (f64, f64) = (0.055, 0.062);
/// What is added to the error of a corner of a printed sheet, px.
const PAPER_SIGMA_PX: f64 = 0.1;
/// Largest side of a robot's tag that leaves room for the white around it, m.
const MAX_ROBOT_SIDE_M: f64 = 0.15;

/// A tag on a sheet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SheetTag {
    pub id: u16,
    /// Of its middle, from the sheet's lower left corner: right and up, m. Its way up is that of the sheet.
    pub middle_m: Point2<f64>,
    /// Of the black rim.
    pub side_m: f64,
}

impl SheetTag {
    /// The corners of the black rim, from the sheet's lower left corner, m: the upper left one, then clockwise.
    pub fn corners_m(&self) -> [Point2<f64>; 4] {
        let half = self.side_m / 2.0;
        [(-half, half), (half, half), (half, -half), (-half, -half)]
            .map(|(right, up)| Point2::new(self.middle_m.x + right, self.middle_m.y + up))
    }
}

/// The tags of a sheet that lies on the floor: two columns from the lower left. `None` if the family has fewer ids from `first_id` on.
pub fn floor_sheet(first_id: u16) -> Option<Vec<SheetTag>> {
    let tag = |index: u16| {
        let (column, row) = (f64::from(index % 2), f64::from(index / 2));
        let middle_m = Point2::new(FIRST_M.0 + column * FLOOR_SPACING_M.0, FIRST_M.1 + row * FLOOR_SPACING_M.1);
        SheetTag { id: first_id + index, middle_m, side_m: FLOOR_SIDE_M }
    };
    crate::tag36h11_modules(first_id.checked_add(FLOOR_TAGS - 1)?)?;
    Some((0..FLOOR_TAGS).map(tag).collect())
}

/// The corners of the tags of a floor sheet that were seen, with their places in the arena. The sheet's lower left corner lies at
/// `origin_m`, its short side `turned_rad` from x; the printer has scaled it by `scale`.
pub fn sheet_points(
    sheet: &[SheetTag],
    seen: &[DetectedTag],
    origin_m: [f64; 2],
    turned_rad: f64,
    scale: f64,
) -> Vec<SeenPoint> {
    let place = Isometry2::new(Vector2::from(origin_m), turned_rad);
    let mut points = Vec::new();
    for found in seen {
        let Some(tag) = sheet.iter().find(|tag| tag.id == found.id) else { continue };
        for (index, (corner, pixel)) in tag.corners_m().iter().zip(found.corners).enumerate() {
            let at = place * (corner * scale);
            let covariance: Matrix2<f64> = found.covariance.fixed_view::<2, 2>(2 * index, 2 * index).into_owned();
            // Paper is not flat, and a lens has more than two terms: no corner is known better than this.
            let covariance = covariance + Matrix2::identity() * PAPER_SIGMA_PX.powi(2);
            points.push(SeenPoint { point: Point3::new(at.x, at.y, 0.0), pixel, covariance });
        }
    }
    points
}

/// The tag of a robot, in the middle of a sheet of its own. `None` for an id that there is not, or a side that does not fit.
pub fn robot_sheet(id: u16, side_m: f64) -> Option<SheetTag> {
    crate::tag36h11_modules(id)?;
    let middle_m = Point2::new(SHEET_SIZE_M.0 / 2.0, SHEET_SIZE_M.1 / 2.0);
    (side_m > 0.0 && side_m <= MAX_ROBOT_SIDE_M).then_some(SheetTag { id, middle_m, side_m })
}
