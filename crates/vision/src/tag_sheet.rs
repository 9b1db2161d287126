//! Tags to print: a sheet for the floor, whose tags have known places on it, and sheets for robots.

use nalgebra::{Isometry2, Matrix2, Point2, Point3, SMatrix, Vector2};

use crate::seen_point::SeenPoint;

/// A4, m.
pub const SHEET_SIZE_M: (f64, f64) = (0.210, 0.297);
/// Length of the line that shows whether the printer has scaled, m.
pub const RULER_M: f64 = 0.1;
/// Tags of a floor sheet.
pub const FLOOR_TAGS: u16 = 4;
/// Their sides, and the distances of their middles along the sheet's short and long side, m.
const FLOOR_SIDE_M: f64 = 0.08;
const FLOOR_SPACING_M: (f64, f64) = (0.1, 0.135);
/// The middle of the first one on the sheet, from its lower left corner, m.
const FIRST_M: (f64, f64) = (0.055, 0.08);
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

/// Where a printed sheet lies in the arena.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SheetPlacement {
    /// Of its lower left corner, m.
    pub origin_m: [f64; 2],
    /// From x to its short side, rad.
    pub turned_rad: f64,
    /// By which the printer has made it larger.
    pub scale: f64,
}

impl SheetPlacement {
    /// The corners of a tag of the sheet with their pixels; `covariance` is that of the pixels' coordinates, px².
    pub fn points(
        &self,
        tag: &SheetTag,
        corners: &[Point2<f64>; 4],
        covariance: &SMatrix<f64, 8, 8>,
    ) -> [SeenPoint; 4] {
        let place = Isometry2::new(Vector2::from(self.origin_m), self.turned_rad);
        let printed = tag.corners_m();
        std::array::from_fn(|index| {
            let at = place * (printed[index] * self.scale);
            let own: Matrix2<f64> = covariance.fixed_view::<2, 2>(2 * index, 2 * index).into_owned();
            // Paper is not flat, and a lens has more than two terms: no corner is known better than this.
            let covariance = own + Matrix2::identity() * PAPER_SIGMA_PX.powi(2);
            SeenPoint { point: Point3::new(at.x, at.y, 0.0), pixel: corners[index], covariance }
        })
    }
}

/// The tag of a robot, in the middle of a sheet of its own. `None` for an id that there is not, or a side that does not fit.
pub fn robot_sheet(id: u16, side_m: f64) -> Option<SheetTag> {
    crate::tag36h11_modules(id)?;
    let middle_m = Point2::new(SHEET_SIZE_M.0 / 2.0, SHEET_SIZE_M.1 / 2.0);
    (side_m > 0.0 && side_m <= MAX_ROBOT_SIDE_M).then_some(SheetTag { id, middle_m, side_m })
}
