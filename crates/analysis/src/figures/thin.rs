//! Fewer points where more cannot be seen: an hour at 100 Hz must not make a picture of 30 megabytes.

use super::svg::Px;

/// Points closer than this to the last drawn one are skipped, in pixels.
const NEAR_PX: f64 = 0.3;

/// Drops points that lie within a third of a pixel of the last kept one; the first and the last always stay.
pub(super) fn thin_path(points: &[Px]) -> Vec<Px> {
    let mut kept: Vec<Px> = Vec::new();
    for (index, point) in points.iter().enumerate() {
        let is_far = kept
            .last()
            .is_none_or(|last| (point.0 - last.0).hypot(point.1 - last.1) >= NEAR_PX);
        if is_far || index + 1 == points.len() {
            kept.push(*point);
        }
    }
    kept
}

/// Keeps, of all points in one column of pixels, the first, the lowest, the highest and the last, in their order: peaks
/// of a time series survive. The points must be ordered by x.
pub(super) fn thin_series(points: &[Px]) -> Vec<Px> {
    points
        .chunk_by(|a, b| a.0.floor() == b.0.floor())
        .flat_map(thin_column)
        .collect()
}

fn thin_column(column: &[Px]) -> Vec<Px> {
    let by_height = |a: &usize, b: &usize| column[*a].1.total_cmp(&column[*b].1);
    let indices = 0..column.len();
    let mut kept: Vec<usize> = [
        indices.clone().next(),
        indices.clone().min_by(by_height),
        indices.clone().max_by(by_height),
        indices.last(),
    ]
    .into_iter()
    .flatten()
    .collect();
    kept.sort_unstable();
    kept.dedup();
    kept.into_iter().map(|index| column[index]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_robot_at_rest_leaves_two_points() {
        let rest = vec![(5.0, 5.0); 1000];
        assert_eq!(thin_path(&rest).len(), 2);
        assert_eq!(thin_path(&rest[..1]).len(), 1);
    }

    #[test]
    fn a_peak_survives_the_thinning_of_its_column() {
        let mut points: Vec<Px> = (0..100).map(|i| (f64::from(i) / 100.0, 1.0)).collect();
        points[37].1 = 9.0;
        points.push((1.5, 2.0));
        assert_eq!(
            thin_series(&points),
            [(0.0, 1.0), (0.37, 9.0), (0.99, 1.0), (1.5, 2.0)]
        );
    }
}
