//! Converts wheel counts, totals or increments, to the total rotation of each wheel.
//!
//! Counts are summed in the file's own unit, in which ticks are exact integers, and converted to radians at the end. A row without an
//! interval is dropped, but its counts are not: the next row includes them.

use posebridge_telemetry::{DriveGeometry, ObservationKind, Radians};

use super::super::column::{Column, WheelTurn};
use super::super::run::{BadRowReason, LoadError, RowError};
use super::super::schema::{Counting, Wheels};
use super::super::table::{BoundColumn, DatasetTable, TableRow};
use super::{RowReader, TimeStep};

pub(in super::super) fn bind(
    stream: &Wheels,
    geometry: DriveGeometry,
    table: &DatasetTable,
) -> Result<RowReader<ObservationKind>, LoadError> {
    let (left_m, right_m) = (geometry.left_wheel_radius.0, geometry.right_wheel_radius.0);
    let mut wheels = WheelReader {
        left: table.bind(&stream.left)?,
        right: table.bind(&stream.right)?,
        rad_per_left: rad_per_unit(&stream.left, left_m, geometry.tick),
        rad_per_right: rad_per_unit(&stream.right, right_m, geometry.tick),
        counting: stream.counting,
        wrap: stream.wrap_bits.map(|bits| f64::from(bits).exp2()),
        max_rad_per_s: stream.max_wheel_rad_per_s.map(|limit| limit.0),
        last: None,
        pending: [0.0; 2],
        total: [0.0; 2],
    };
    Ok(Box::new(move |row, step| wheels.read(row, step).map(Some)))
}

/// Radians per unit of the column: ticks, metres or radians.
fn rad_per_unit(column: &Column<WheelTurn>, radius_m: f64, tick: Radians) -> f64 {
    match column.unit.name {
        "ticks" => tick.0,
        "m" | "mm" => 1.0 / radius_m,
        _ => 1.0,
    }
}

#[derive(Debug)]
struct WheelReader {
    left: BoundColumn<WheelTurn>,
    right: BoundColumn<WheelTurn>,
    rad_per_left: f64,
    rad_per_right: f64,
    counting: Counting,
    /// Counts per wrap of the counter; `None` if it does not wrap.
    wrap: Option<f64>,
    max_rad_per_s: Option<f64>,
    last: Option<[f64; 2]>,
    /// Since the last good row.
    pending: [f64; 2],
    /// Until the last good row; for absolute counters relative to the first counts.
    total: [f64; 2],
}

impl WheelReader {
    fn read(&mut self, row: &TableRow<'_>, step: TimeStep) -> Result<ObservationKind, RowError> {
        let counts = [self.left.read(row)?, self.right.read(row)?];
        if step == TimeStep::First {
            self.reset_counts(counts);
        } else {
            self.add_counts(counts);
            if let Some(interval_s) = step.interval_s()? {
                self.check_speed(interval_s)?;
            }
            self.total = [self.total[0] + self.pending[0], self.total[1] + self.pending[1]];
            self.pending = [0.0; 2];
        }
        Ok(ObservationKind::WheelAngles {
            left: Radians(self.total[0] * self.rad_per_left),
            right: Radians(self.total[1] * self.rad_per_right),
        })
    }

    fn reset_counts(&mut self, counts: [f64; 2]) {
        match self.counting {
            Counting::Absolute => {
                self.last = Some(counts);
                self.total = counts;
            }
            // They belong to an interval before the recording.
            Counting::Increments => self.total = [0.0; 2],
        }
    }

    fn add_counts(&mut self, counts: [f64; 2]) {
        let last = match self.counting {
            Counting::Absolute => self.last.replace(counts).unwrap_or(counts),
            Counting::Increments => [0.0; 2],
        };
        for ((pending, count), last) in self.pending.iter_mut().zip(counts).zip(last) {
            let step = count - last;
            *pending += match self.wrap {
                None => step,
                Some(turn) => step - (step / turn).round() * turn,
            };
        }
    }

    /// Rejects and drops motion above the speed limit: the return of a spike cancels it.
    fn check_speed(&mut self, interval_s: f64) -> Result<(), RowError> {
        let Some(limit) = self.max_rad_per_s else {
            return Ok(());
        };
        let left = (self.pending[0] * self.rad_per_left / interval_s).abs();
        let right = (self.pending[1] * self.rad_per_right / interval_s).abs();
        if left.max(right) <= limit {
            return Ok(());
        }
        self.pending = [0.0; 2];
        let detail = format!("wheels at {left:.1} and {right:.1} rad/s, the limit is {limit}");
        Err(RowError::new(BadRowReason::ImpossibleJump, detail))
    }
}
