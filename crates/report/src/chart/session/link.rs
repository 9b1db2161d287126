//! How a link did over time: what came and left, what went wrong, how long it took, and what waited.
//!
//! Counters only grow, so a rate is the difference of two of them over the time between; a frame that was missing and comes late is
//! taken off its count, which is no negative loss.

use posebridge_telemetry::LinkCounter;

use super::super::plot::CurveShape;
use super::super::strip::{StripChart, StripPanel, StyledCurve, render_strip};
use super::{LinkSample, curve_style};

const HEIGHT_PX: f64 = 92.0;

const TRAFFIC_COUNTERS: [LinkCounter; 2] = [LinkCounter::FRAMES_IN, LinkCounter::FRAMES_OUT];

const ERROR_COUNTERS: [LinkCounter; 9] = [
    LinkCounter::FRAMES_LOST,
    LinkCounter::CHECKSUM_ERRORS,
    LinkCounter::TIMEOUTS,
    LinkCounter { label: "unknown", ..LinkCounter::UNKNOWN_IDS },
    LinkCounter::REJECTED_FRAMES,
    LinkCounter::DUPLICATES,
    LinkCounter::RATE_LIMITED,
    LinkCounter::UNSENT,
    LinkCounter::RECONNECTS,
];

const GARBAGE_COUNTERS: [LinkCounter; 1] = [LinkCounter::GARBAGE_BYTES];

/// Draws it; returns a whole SVG document. What never happened has no curve.
pub fn render_link(title: &str, samples: &[LinkSample]) -> String {
    let mut panels = vec![rates("frames/s", &TRAFFIC_COUNTERS, samples)];
    for (name, counters) in [("per second", &ERROR_COUNTERS[..]), ("bytes/s", &GARBAGE_COUNTERS[..])] {
        let panel = rates(name, counters, samples);
        if !panel.curves.is_empty() {
            panels.push(panel);
        }
    }
    panels.extend(round_trip(samples));
    panels.extend(queue_panel(samples));
    render_strip(&StripChart { title: title.to_owned(), x_name: "time [s]".to_owned(), panels })
}

fn rates(y_name: &str, counters: &[LinkCounter], samples: &[LinkSample]) -> StripPanel {
    let last = samples.last();
    let happened = |counter: &&LinkCounter| last.is_some_and(|last| (counter.read)(&last.health) > 0);
    let curves = counters.iter().filter(happened).enumerate();
    let curves = curves.map(|(place, counter)| {
        let rate = samples.windows(2).filter_map(|pair| {
            let [before, after] = pair else { return None };
            let elapsed_s = after.t_s - before.t_s;
            let grown = (counter.read)(&after.health).saturating_sub((counter.read)(&before.health));
            (elapsed_s > 0.0).then(|| (after.t_s, grown as f64 / elapsed_s))
        });
        StyledCurve::new(counter.label, CurveShape::Line(rate.collect()), curve_style(place + 1))
    });
    StripPanel { y_name: y_name.to_owned(), height_px: HEIGHT_PX, curves: curves.collect(), ..StripPanel::default() }
}

fn round_trip(samples: &[LinkSample]) -> Option<StripPanel> {
    let points = samples.iter().filter_map(|sample| {
        let round_trip = sample.health.round_trip?;
        Some((sample.t_s, round_trip.as_millis_f64()))
    });
    single_curve_panel("[ms]", "round trip", points.collect())
}

fn queue_panel(samples: &[LinkSample]) -> Option<StripPanel> {
    let has_waited = |sample: &LinkSample| sample.health.port.queued_frames > 0;
    if !samples.iter().any(has_waited) {
        return None;
    }
    let points = samples.iter().map(|sample| (sample.t_s, f64::from(sample.health.port.queued_frames)));
    single_curve_panel("frames", "waiting to be sent", points.collect())
}

fn single_curve_panel(y_name: &str, name: &str, points: Vec<(f64, f64)>) -> Option<StripPanel> {
    if points.is_empty() {
        return None;
    }
    Some(StripPanel {
        y_name: y_name.to_owned(),
        height_px: HEIGHT_PX,
        curves: vec![StyledCurve::new(name, CurveShape::Line(points), curve_style(2))],
        ..StripPanel::default()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_telemetry::{LinkHealth, TimeDelta};

    fn sample(t_s: f64, frames_in: u64, frames_lost: u64) -> LinkSample {
        LinkSample {
            t_s,
            health: LinkHealth {
                frames_in,
                frames_lost,
                round_trip: Some(TimeDelta::from_millis(31)),
                ..LinkHealth::default()
            },
        }
    }

    #[test]
    fn rates_are_differences_over_time_and_what_never_happened_is_not_there() {
        let svg = render_link("link 0", &[sample(1.0, 50, 0), sample(2.0, 100, 4), sample(4.0, 200, 2)]);
        assert!(svg.contains(">received</text>") && svg.contains(">lost</text>"));
        assert!(svg.contains(">round trip</text>"));
        assert!(!svg.contains(">sent</text>") && !svg.contains("garbage") && !svg.contains("waiting"));
        let panel = rates("", &TRAFFIC_COUNTERS, &[sample(1.0, 50, 0), sample(3.0, 150, 0)]);
        let CurveShape::Line(points) = &panel.curves[0].shape else { panic!("a rate is a line") };
        assert_eq!(points, &[(3.0, 50.0)]);
    }

    #[test]
    fn a_frame_that_comes_late_is_no_negative_loss() {
        let panel = rates("", &ERROR_COUNTERS, &[sample(1.0, 0, 5), sample(2.0, 0, 2)]);
        let CurveShape::Line(points) = &panel.curves[0].shape else { panic!("a rate is a line") };
        assert_eq!(points, &[(2.0, 0.0)]);
    }
}
