//! A board that prints lines of text and hears nothing: a sketch with `Serial.println`.

use std::collections::VecDeque;

use posebridge_telemetry::{BrickClock, TimeDelta, Timestamp};

use crate::scenario::{Scenario, TextField, TextPart};
use crate::sensors::{InertialReading, SensorBoard};
use crate::wheels::PerWheel;

#[derive(Debug)]
pub(crate) struct TextBoard {
    line: Vec<TextPart>,
    /// Waits to be printed at power-up.
    header: Option<String>,
    period: TimeDelta,
    due: Timestamp<BrickClock>,
}

impl TextBoard {
    pub(super) fn new(scenario: &Scenario, now: Timestamp<BrickClock>) -> Self {
        let settings = &scenario.text_board;
        Self {
            line: settings.line.clone(),
            header: (!settings.header.is_empty()).then(|| settings.header.clone()),
            period: TimeDelta::from_secs_f64(1.0 / scenario.brick.telemetry_hz),
            due: now,
        }
    }

    pub(super) fn step(
        &mut self,
        now: Timestamp<BrickClock>,
        board: &mut SensorBoard,
        outgoing: &mut VecDeque<Vec<u8>>,
    ) {
        if now < self.due {
            return;
        }
        self.due = self.due + self.period;
        outgoing.extend(self.header.take().map(|header| format!("{header}\r\n").into_bytes()));
        let (counts, inertial) = (board.counts(), board.read_inertial());
        let parts = self.line.iter().map(|part| match part {
            TextPart::Words(words) => words.clone(),
            TextPart::Field(field) => field_text(*field, now, counts, &inertial),
        });
        outgoing.push_back(format!("{}\r\n", parts.collect::<String>()).into_bytes());
    }

    pub(super) const fn restart(&mut self, now: Timestamp<BrickClock>) {
        self.due = now;
    }
}

fn field_text(
    field: TextField,
    now: Timestamp<BrickClock>,
    counts: PerWheel<i64>,
    inertial: &InertialReading,
) -> String {
    let micros = now.as_micros();
    let turn_rate = inertial.turn_rate_rad_per_s;
    match field {
        // `millis()` and `micros()` have 32 bits.
        TextField::TimeMs => ((micros / 1_000) as u32).to_string(),
        TextField::TimeUs => (micros as u32).to_string(),
        TextField::TimeS => format!("{:.3}", micros as f64 * 1e-6),
        TextField::LeftTicks => counts.left.to_string(),
        TextField::RightTicks => counts.right.to_string(),
        TextField::LeftTicksBackward => (-counts.left).to_string(),
        TextField::RightTicksBackward => (-counts.right).to_string(),
        TextField::GyroDegPerS => format!("{:.2}", turn_rate.to_degrees()),
        TextField::GyroRadPerS => format!("{turn_rate:.4}"),
        TextField::GyroClockwiseDegPerS => format!("{:.2}", -turn_rate.to_degrees()),
    }
}
