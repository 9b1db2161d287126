//! Fewer points where more cannot be seen: an hour at 100 Hz must not make a picture of 30 megabytes.

use super::svg::PixelPoint;

/// Points closer than this to the last drawn one are skipped, in pixels.
const NEAR_PX: f64 = 0.3;

/// Drops points that lie within a third of a pixel of the last kept one; the first and the last always stay.
pub(super) fn downsample_path(points: &[PixelPoint]) -> Vec<PixelPoint> {
    let mut kept: Vec<PixelPoint> = Vec::new();
    for (index, point) in points.iter().enumerate() {
        let is_far = kept.last().is_none_or(|last| (point.0 - last.0).hypot(point.1 - last.1) >= NEAR_PX);
        if is_far || index + 1 == points.len() {
            kept.push(*point);
        }
    }
    kept
}

/// Keeps, of all points in one column of pixels, the first, the lowest, the highest and the last, in their order: peaks
/// of a time series survive. The points must be ordered by x.
pub(super) fn downsample_series(points: &[PixelPoint]) -> Vec<PixelPoint> {
    points.chunk_by(|a, b| a.0.floor() == b.0.floor()).flat_map(downsample_column).collect()
}

fn downsample_column(column: &[PixelPoint]) -> Vec<PixelPoint> {
    let by_height = |a: &usize, b: &usize| column[*a].1.total_cmp(&column[*b].1);
    let indices = 0..column.len();
    let mut kept: Vec<usize> =
        [indices.clone().next(), indices.clone().min_by(by_height), indices.clone().max_by(by_height), indices.last()]
            .into_iter()
            .flatten()
            .collect();
    kept.sort_unstable();
    kept.dedup();
    kept.into_iter().map(|index| column[index]).collect()
}

/// Fewer points of a line. No removed point lies further than `tolerance_px` from the rest: corners and peaks stay, straight
/// stretches need two points.
///
/// Pieces of [`PIECE`] points are simplified one by one, so that no line takes time that grows with its square.
///
/// Source: Douglas and Peucker (1973), "Algorithms for the reduction of the number of points required to represent a digitized line".
pub(super) fn downsample_by_deviation(points: &[PixelPoint], tolerance_px: f64) -> Vec<PixelPoint> {
    let mut kept: Vec<PixelPoint> = points.first().copied().into_iter().collect();
    let mut from = 0;
    while from + 1 < points.len() {
        let to = (from + CHUNK_POINTS).min(points.len() - 1);
        let piece = points.get(from..=to).unwrap_or_default();
        kept.extend(simplify(piece, tolerance_px).into_iter().skip(1));
        from = to;
    }
    kept
}

/// Points that are simplified at a time.
const CHUNK_POINTS: usize = 512;

/// The first, the last, and those between them that are needed.
fn simplify(points: &[PixelPoint], tolerance_px: f64) -> Vec<PixelPoint> {
    let last = points.len().saturating_sub(1);
    let mut needed = vec![false; points.len()];
    let mut open = vec![(0, last)];
    while let Some((from, to)) = open.pop() {
        for end in [from, to] {
            if let Some(flag) = needed.get_mut(end) {
                *flag = true;
            }
        }
        if let Some((farthest, distance_px)) = farthest_between(points, from, to)
            && distance_px > tolerance_px
        {
            open.extend([(from, farthest), (farthest, to)]);
        }
    }
    let kept = points.iter().zip(needed);
    kept.filter_map(|(point, is_needed)| is_needed.then_some(*point)).collect()
}

/// The point that lies farthest from the straight stretch between two others, and how far; `None` if there is none between.
fn farthest_between(points: &[PixelPoint], from: usize, to: usize) -> Option<(usize, f64)> {
    let (start, end) = (*points.get(from)?, *points.get(to)?);
    let (along_x, along_y) = (end.0 - start.0, end.1 - start.1);
    let length_squared = along_x * along_x + along_y * along_y;
    let distance_px = |point: &PixelPoint| {
        let (x, y) = (point.0 - start.0, point.1 - start.1);
        let share =
            if length_squared > 0.0 { ((x * along_x + y * along_y) / length_squared).clamp(0.0, 1.0) } else { 0.0 };
        (x - share * along_x).hypot(y - share * along_y)
    };
    let between = points.iter().enumerate().take(to).skip(from + 1);
    between.map(|(index, point)| (index, distance_px(point))).max_by(|a, b| a.1.total_cmp(&b.1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_robot_at_rest_leaves_two_points() {
        let rest = vec![(5.0, 5.0); 1000];
        assert_eq!(downsample_path(&rest).len(), 2);
        assert_eq!(downsample_path(&rest[..1]).len(), 1);
    }

    #[test]
    fn a_thinned_line_stays_within_the_tolerance_and_needs_few_points() {
        let circle: Vec<PixelPoint> = (0..5_000)
            .map(|step| {
                let (sin, cos) = (f64::from(step) / 400.0).sin_cos();
                (100.0 * cos, 100.0 * sin)
            })
            .collect();
        let thin = downsample_by_deviation(&circle, 0.2);
        assert!((40..400).contains(&thin.len()), "{}", thin.len());
        assert_eq!((thin.first(), thin.last()), (circle.first(), circle.last()));
        for point in &circle {
            let nearest = thin.windows(2).map(|ends| {
                let pair = [ends[0], *point, ends[1]];
                farthest_between(&pair, 0, 2).unwrap().1
            });
            assert!(nearest.fold(f64::MAX, f64::min) <= 0.2);
        }
        assert!(downsample_by_deviation(&[], 0.2).is_empty());
        assert_eq!(downsample_by_deviation(&circle[..1], 0.2).len(), 1);
    }

    #[test]
    fn a_straight_line_keeps_its_ends_and_a_spike_stays() {
        let mut line: Vec<PixelPoint> = (0..300).map(|x| (f64::from(x), 0.0)).collect();
        assert_eq!(downsample_by_deviation(&line, 0.1).len(), 2);
        line[150].1 = 5.0;
        assert_eq!(
            downsample_by_deviation(&line, 0.1),
            [(0.0, 0.0), (149.0, 0.0), (150.0, 5.0), (151.0, 0.0), (299.0, 0.0)]
        );
    }

    #[test]
    fn a_peak_survives_the_thinning_of_its_column() {
        let mut points: Vec<PixelPoint> = (0..100).map(|i| (f64::from(i) / 100.0, 1.0)).collect();
        points[37].1 = 9.0;
        points.push((1.5, 2.0));
        assert_eq!(downsample_series(&points), [(0.0, 1.0), (0.37, 9.0), (0.99, 1.0), (1.5, 2.0)]);
    }
}
