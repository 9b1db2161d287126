//! Derivative-free maximisation of a function of a few variables: polls along the axes, all points of a round at once.
//!
//! A round evaluates one step up and one step down along each axis. Then it evaluates three combinations: all successful steps
//! together, the same twice as long, and the best single one twice as long. The best point is the next centre; without an improvement
//! the step is halved. All points of a round are evaluated together, so that the caller may use all cores.

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SearchOptions {
    pub first_step: f64,
    /// The search ends when the step is smaller.
    pub last_step: f64,
    /// Each variable stays in [-bound, bound].
    pub bound: f64,
    /// Smaller improvements count as noise, so that flat directions do not drift.
    pub min_gain: f64,
    pub max_rounds: u32,
}

impl Default for SearchOptions {
    /// For log-scales of standard deviations, and a sum of log-likelihoods.
    fn default() -> Self {
        Self {
            // A factor of e^1.2 = 3.3; ten times wrong is two steps away.
            first_step: 1.2,
            // 4 %: finer than a recording of some hundred innovations can resolve.
            last_step: 0.04,
            // A factor of 1000.
            bound: 6.91,
            // A tenth of what chance makes of the maximum (half a unit per variable, Wilks 1938).
            min_gain: 0.05,
            max_rounds: 40,
        }
    }
}

#[derive(Clone, Debug, PartialEq)]
pub struct SearchRound {
    /// Largest value so far.
    pub value: f64,
    pub at: Vec<f64>,
    pub step: f64,
}

#[derive(Clone, Debug, PartialEq)]
pub struct SearchResult {
    /// At zero.
    pub start_value: f64,
    pub at: Vec<f64>,
    pub value: f64,
    pub rounds: Vec<SearchRound>,
    /// One standard deviation of each variable with the others fixed, from the curvature of a log-likelihood; `None` where it is flat.
    pub sigma: Vec<Option<f64>>,
    /// No step of the smallest size helped; else the rounds were used up.
    pub has_converged: bool,
}

/// Step of the second difference: large enough for a rough function.
const CURVATURE_STEP: f64 = 0.2;

struct SearchPoint {
    at: Vec<f64>,
    value: f64,
}

/// Starts at zero. `evaluate` returns one value for each point of a round; a non-finite value counts as the worst.
pub fn maximise(
    variables: usize,
    search: &SearchOptions,
    mut evaluate: impl FnMut(&[Vec<f64>]) -> Vec<f64>,
) -> SearchResult {
    let mut score_points = |points: &[Vec<f64>]| -> Vec<f64> {
        let values = evaluate(points);
        let finite = |value: f64| {
            if value.is_finite() { value } else { f64::NEG_INFINITY }
        };
        values.into_iter().map(finite).collect()
    };
    let start = vec![0.0; variables];
    let start_value = score_points(std::slice::from_ref(&start)).first().copied().unwrap_or(f64::NEG_INFINITY);
    let mut best = SearchPoint { at: start, value: start_value };
    let mut step = search.first_step;
    let mut rounds = Vec::new();
    let mut has_converged = false;
    for _ in 0..search.max_rounds {
        if step < search.last_step || variables == 0 {
            has_converged = true;
            break;
        }
        let polled = poll_points(&best.at, step, search.bound);
        let values = score_points(&polled);
        let combined = combinations(&best, &polled, &values, search);
        let more = score_points(&combined);
        let all = polled.into_iter().zip(values).chain(combined.into_iter().zip(more));
        let top = all.max_by(|a, b| a.1.total_cmp(&b.1));
        match top.filter(|top| top.1 > best.value + search.min_gain) {
            Some((at, value)) => best = SearchPoint { at, value },
            None => step *= 0.5,
        }
        rounds.push(SearchRound { value: best.value, at: best.at.clone(), step });
    }
    let sigma = sigmas(&best, &mut score_points);
    SearchResult { start_value, at: best.at, value: best.value, rounds, sigma, has_converged }
}

/// One step up and one down along each axis: points 2 j and 2 j + 1.
fn poll_points(centre: &[f64], step: f64, bound: f64) -> Vec<Vec<f64>> {
    let along = |j: usize, by: f64| {
        let mut point = centre.to_vec();
        if let Some(value) = point.get_mut(j) {
            *value = (*value + by).clamp(-bound, bound);
        }
        point
    };
    (0..centre.len()).flat_map(|j| [along(j, step), along(j, -step)]).collect()
}

/// All successful steps, the same doubled, and the best single one doubled; empty without an improvement.
fn combinations(best: &SearchPoint, polled: &[Vec<f64>], values: &[f64], search: &SearchOptions) -> Vec<Vec<f64>> {
    let centre = &best.at;
    let mut together = vec![0.0; centre.len()];
    let mut single: Option<(f64, &Vec<f64>)> = None;
    for (j, (points, values)) in polled.chunks(2).zip(values.chunks(2)).enumerate() {
        let better = points.iter().zip(values).max_by(|a, b| a.1.total_cmp(b.1));
        let Some((point, gained)) = better.filter(|(_, gained)| **gained > best.value + search.min_gain) else {
            continue;
        };
        if let (Some(to), Some(end), Some(from)) = (together.get_mut(j), point.get(j), centre.get(j)) {
            *to = end - from;
        }
        if single.is_none_or(|(most, _)| *gained > most) {
            single = Some((*gained, point));
        }
    }
    let Some((_, single)) = single else {
        return Vec::new();
    };
    let beyond = |by: &[f64], times: f64| -> Vec<f64> {
        let moved = centre.iter().zip(by).map(|(from, by)| from + times * by);
        moved.map(|value| value.clamp(-search.bound, search.bound)).collect()
    };
    let alone: Vec<f64> = single.iter().zip(centre).map(|(end, from)| end - from).collect();
    vec![beyond(&together, 1.0), beyond(&together, 2.0), beyond(&alone, 2.0)]
}

fn sigmas(best: &SearchPoint, evaluate: &mut impl FnMut(&[Vec<f64>]) -> Vec<f64>) -> Vec<Option<f64>> {
    let values = evaluate(&poll_points(&best.at, CURVATURE_STEP, f64::INFINITY));
    let pairs = values.chunks(2).map(|pair| {
        let [up, down] = pair else { return None };
        let curvature = (2.0 * best.value - up - down) / (CURVATURE_STEP * CURVATURE_STEP);
        (curvature.is_finite() && curvature > 0.0).then(|| curvature.sqrt().recip())
    });
    pairs.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A ridge across the axes, its top at (2.3, -1.1), of curvature 100 along x.
    fn ridge(point: &[f64]) -> f64 {
        let (x, y) = (point[0] - 2.3, point[1] + 1.1);
        -(50.0 * x * x + 40.0 * y * y + 60.0 * x * y)
    }

    #[test]
    fn the_top_of_a_ridge_is_found_with_its_curvature() {
        let found = maximise(2, &SearchOptions::default(), |points| points.iter().map(|point| ridge(point)).collect());
        assert!((found.at[0] - 2.3).abs() < 0.06 && (found.at[1] + 1.1).abs() < 0.06, "{found:?}");
        assert!(found.has_converged);
        assert!((found.sigma[0].unwrap() - 0.1).abs() < 1e-9);
        assert!(found.rounds.windows(2).all(|pair| pair[0].value <= pair[1].value));
    }

    #[test]
    fn a_flat_direction_stays_and_has_no_sigma() {
        let search = SearchOptions::default();
        let found = maximise(2, &search, |points| points.iter().map(|point| -point[0] * point[0]).collect());
        assert_eq!(found.at, [0.0, 0.0]);
        assert_eq!(found.sigma[1], None);
    }

    #[test]
    fn no_variable_leaves_its_bounds_and_what_is_no_number_is_avoided() {
        let search = SearchOptions { bound: 2.0, ..SearchOptions::default() };
        let found = maximise(1, &search, |points| {
            points.iter().map(|point| if point[0] > 1.5 { f64::NAN } else { 10.0 * point[0] }).collect()
        });
        assert!(found.at[0] > 1.3 && found.at[0] <= 1.5, "{found:?}");
        let up = maximise(1, &search, |points| points.iter().map(|point| 10.0 * point[0]).collect());
        assert_eq!(up.at, [2.0]);
    }

    #[test]
    fn it_ends_when_the_rounds_are_used_up() {
        let search = SearchOptions { max_rounds: 2, ..SearchOptions::default() };
        let found = maximise(2, &search, |points| points.iter().map(|point| ridge(point)).collect());
        assert_eq!((found.rounds.len(), found.has_converged), (2, false));
        let none = maximise(0, &search, |points| vec![1.0; points.len()]);
        assert_eq!((none.at.len(), none.has_converged), (0, true));
    }
}
