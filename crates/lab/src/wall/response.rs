//! What a unit of steady speed would have done: the way phi(t) under the inputs of a log, for a given rate a.

use super::log::{WallLog, WallReading};

/// A reading with the way that a steady speed of 1 m/s per unit of input would have led by then, in metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ResponseSample {
    pub(super) at_s: f64,
    pub(super) range_m: f64,
    pub(super) distance_m: f64,
}

/// The readings of a log with their ways; exact, as the input is held from one entry to the next. At rest at the first entry.
pub(super) fn responses(log: &WallLog, rate_per_s: f64) -> Vec<ResponseSample> {
    let mut readings = Vec::new();
    let Some(first) = log.entries().first() else {
        return readings;
    };
    let (mut at_s, mut way_m, mut speed, mut input) = (first.at_s, 0.0, 0.0, 0.0);
    for entry in log.entries() {
        let dt_s = entry.at_s - at_s;
        let decayed = -(-rate_per_s * dt_s).exp_m1();
        way_m += input * dt_s + (speed - input) * decayed / rate_per_s;
        speed += (input - speed) * decayed;
        at_s = entry.at_s;
        match entry.reading {
            WallReading::Input(next) => input = next,
            WallReading::Range(range_m) => readings.push(ResponseSample { at_s, range_m, distance_m: way_m }),
        }
    }
    readings
}

#[cfg(test)]
mod tests {
    use super::super::log::WallEntry;
    use super::*;

    #[test]
    fn the_way_is_that_of_the_differential_equation() {
        let inputs = [(0.0, 1.0), (0.7, -0.4), (0.9, 0.2)];
        let entries = inputs.map(|(at_s, input)| WallEntry { at_s, reading: WallReading::Input(input) });
        let reading = WallEntry { at_s: 1.4, reading: WallReading::Range(2.0) };
        let log = WallLog::new(entries.into_iter().chain([reading]).collect());
        let found = responses(&log, 2.3)[0].distance_m;
        let (mut way, mut speed, parts) = (0.0, 0.0, 1_400_000);
        for part in 0..parts {
            let at_s = 1.4 * f64::from(part) / f64::from(parts);
            let input = inputs.iter().rfind(|(from, _)| *from <= at_s).unwrap().1;
            way += speed * 1e-6;
            speed += 2.3 * (input - speed) * 1e-6;
        }
        assert!((found - way).abs() < 1e-5, "{found} {way}");
    }
}
