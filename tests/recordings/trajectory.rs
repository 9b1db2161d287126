//! Trajectories as `posebridge export --format tum` writes them.

use std::path::Path;

/// Stamp, x and y of each line.
pub(crate) fn trajectory(path: &Path) -> Vec<(f64, f64, f64)> {
    let text = std::fs::read_to_string(path).unwrap();
    let poses = text.lines().map(|line| {
        let fields: Vec<f64> = line.split(' ').map(|field| field.parse().unwrap()).collect();
        assert_eq!(fields.len(), 8, "{line}");
        (fields[0], fields[1], fields[2])
    });
    poses.collect()
}

/// How many stamps two trajectories have in common, and how far they are apart there at most, m.
pub(crate) fn worst_distance(one: &[(f64, f64, f64)], other: &[(f64, f64, f64)]) -> (usize, f64) {
    let (mut compared, mut worst_m) = (0, 0.0_f64);
    for (stamp, x, y) in other {
        if let Ok(index) = one.binary_search_by(|(here, ..)| here.total_cmp(stamp)) {
            let (_, here_x, here_y) = one[index];
            // At first a fix may come before the clocks are aligned in one of the two.
            if compared > 100 {
                worst_m = worst_m.max((x - here_x).hypot(y - here_y));
            }
            compared += 1;
        }
    }
    (compared, worst_m)
}
