//! What the guide says to a person.

use posebridge_estimator::hand_motions::{GuideEvent, GuideSettings, GuideStep, SetupGuide, WheelUnit};
use posebridge_report::tables;
use posebridge_telemetry::{Polarity, UncertainValue};

/// For a person at a terminal, below a prompt.
pub(super) const KEYS: &str = "  (Enter: it is over now; a: the one before again; s: leave it out; q: stop)";

pub(super) fn prompt_lines(step: GuideStep, settings: &GuideSettings) -> Vec<String> {
    let turns = |turns: f64| if turns == 1.0 { "one full turn".to_owned() } else { format!("{turns} full turns") };
    let (title, what) = match step {
        GuideStep::WheelTurn => (
            "the left wheel",
            format!(
                "Lift the robot and turn its left wheel by hand, forward as when it drives on, by {}: a mark on the tyre helps.",
                turns(settings.wheel_turns)
            ),
        ),
        GuideStep::Straight => (
            "straight on",
            format!(
                "Put it on the floor and roll it straight on, forward, by exactly {} m along a ruler. Both wheels must turn.",
                settings.straight_m
            ),
        ),
        GuideStep::SpotTurn => (
            "on the spot",
            format!(
                "Turn it on the spot to the left (counter-clockwise from above) by {}, back to where it pointed.",
                turns(settings.turns)
            ),
        ),
    };
    let number = settings.steps.iter().position(|other| *other == step).map_or(1, |index| index + 1);
    let count = settings.steps.len();
    let lines = [String::new(), format!("Motion {number} of {count}: {title}")];
    let asked = wrapped(&format!("{what} Then leave it for {} s.", settings.rest.as_secs_f64()));
    lines.into_iter().chain(asked).collect()
}

pub(super) fn event_lines(event: &GuideEvent, guide: &SetupGuide) -> Vec<String> {
    match event {
        GuideEvent::MotionBegan(_) => vec!["  it moves ..".to_owned()],
        GuideEvent::StepDone(step) => wrapped(&done(*step, guide)),
        GuideEvent::StepFailed(_, problem) => wrapped(&format!("{problem}. Once more, please.")),
    }
}

fn done(step: GuideStep, guide: &SetupGuide) -> String {
    let figures = guide.figures();
    let backward = |polarity: Polarity| if polarity == Polarity::Reversed { ", backwards" } else { "" };
    match step {
        GuideStep::WheelTurn => figures.wheel.map_or_else(String::new, |wheel| {
            let counted = wheel
                .ticks_per_turn
                .map_or("moved".to_owned(), |ticks| format!("counted {:.0} in a turn", ticks.value));
            format!("the {} counter {counted}{}", wheel.counter.name(), backward(wheel.polarity))
        }),
        GuideStep::Straight => figures.straight.map_or_else(String::new, |straight| {
            let [left, right] = straight.m_per_count;
            let [left_word, right_word] = straight.polarity.map(backward);
            match guide.log().unit() {
                WheelUnit::Counts => format!(
                    "{:.3} mm in a count of the left counter{left_word}, {:.3} mm of the right one{right_word}",
                    1e3 * left.value,
                    1e3 * right.value
                ),
                WheelUnit::Meters => format!(
                    "a metre is {:.3} m of the robot's left wheel{left_word}, {:.3} m of its right one{right_word}",
                    left.value.recip(),
                    right.value.recip()
                ),
            }
        }),
        GuideStep::SpotTurn => figures.spot.map_or_else(String::new, |spot| {
            let UncertainValue { value, .. } = spot.track_m;
            let gyro = spot.gyro_ratio.map_or_else(
                || "no gyro was heard".to_owned(),
                |ratio| format!("the gyro turned {:.3} times as far", ratio.value),
            );
            if figures.straight.is_some() { format!("the track is {:.1} mm wide; {gyro}", 1e3 * value) } else { gyro }
        }),
    }
}

/// Lines of at most 80 columns, indented.
fn wrapped(text: &str) -> Vec<String> {
    tables::wrapped("  ", text).lines().map(str::to_owned).collect()
}
