//! The paper's figures 5, 6 and 7 of one drive: wheels, speeds, tracks.

use posebridge_estimator::FilterConfig;
use posebridge_report::chart::plot::{Axes, Curve, CurveShape, Plot, render_plot};
use posebridge_telemetry::DriveGeometry;

use super::matched::{DriveState, WheelMatrices, WheelState};
use super::score::true_speeds;
use super::table::SensorTable;

/// One drive and what the methods made of it.
#[derive(Clone, Debug)]
pub struct SquareExample {
    /// The drive.
    pub table: SensorTable,
    /// The configuration of the filters.
    pub config: FilterConfig,
    /// Of how many images one is given to the filters.
    pub camera_every: usize,
    /// The path of each method, by its name.
    pub paths: Vec<(&'static str, Vec<DriveState>)>,
}

fn curve(name: &str, points: Vec<(f64, f64)>) -> Curve {
    Curve { name: name.to_owned(), shape: CurveShape::Line(points) }
}

impl SquareExample {
    fn path(&self, name: &str) -> &[DriveState] {
        let known = self.paths.iter().find(|(known, _)| *known == name);
        known.map_or(&[], |(_, path)| path)
    }

    fn over_time(&self, values: impl Fn(usize) -> Option<f64>) -> Vec<(f64, f64)> {
        let rows = self.table.rows.iter().enumerate();
        rows.filter_map(|(row, known)| Some((known.time_s, values(row)?))).collect()
    }

    /// The two wheels' angles and rates, degrees: counted, and filtered with these matrices, row by row.
    fn wheels(&self, matrices: WheelMatrices) -> Vec<[WheelState; 2]> {
        let unit_deg = self.table.unit.rad_per_unit(&self.config.geometry).to_degrees();
        let mut wheels = [WheelState::at_rest(matrices.start); 2];
        let base = self.table.rows.first().map_or([0.0; 2], |row| row.encoders);
        let mut before_s = None;
        let rows = self.table.rows.iter().map(|row| {
            if let Some(before_s) = before_s.replace(row.time_s) {
                for (side, wheel) in wheels.iter_mut().enumerate() {
                    wheel.predict(row.time_s - before_s, &matrices.process);
                    let counted = (row.encoders[side] - base[side]) * unit_deg;
                    wheel.update(counted, matrices.variances[side]);
                }
            }
            wheels
        });
        rows.collect()
    }

    /// Figure 5: the left wheel's angle and both wheels' speeds, counted and filtered.
    pub fn wheel_figure(&self) -> String {
        let unit_deg = self.table.unit.rad_per_unit(&self.config.geometry).to_degrees();
        let rows = &self.table.rows;
        let printed = self.wheels(WheelMatrices::PRINTED);
        let own = self.wheels(WheelMatrices::of_robot(&self.config));
        let base = rows.first().map_or([0.0; 2], |row| row.encoders);
        let side = |side: usize| {
            let counted = self.over_time(|row| {
                let before = rows.get(row.checked_sub(1)?)?;
                let dt_s = rows[row].time_s - before.time_s;
                Some((rows[row].encoders[side] - before.encoders[side]) * unit_deg / dt_s)
            });
            vec![
                curve("differences of counts", counted),
                curve("wheel-kf, printed", self.over_time(|row| Some(printed[row][side].rate))),
                curve("wheel-kf, own R and Q", self.over_time(|row| Some(own[row][side].rate))),
            ]
        };
        let angle = |side: usize| self.over_time(|row| Some((rows[row].encoders[side] - base[side]) * unit_deg));
        let angles = vec![
            curve("left, counted", angle(0)),
            curve("left, wheel-kf", self.over_time(|row| Some(printed[row][0].phi))),
            curve("right, counted", angle(1)),
            curve("right, wheel-kf", self.over_time(|row| Some(printed[row][1].phi))),
        ];
        render_figure(
            "Wheel positions and speeds",
            "figure 5 of the paper: what a counter says, and one Kalman filter per wheel",
            vec![
                ("angle [degrees]", angles),
                ("left wheel [degrees/s]", side(0)),
                ("right wheel [degrees/s]", side(1)),
            ],
        )
    }

    /// Figure 6: v and w.
    pub fn speed_figure(&self, names: &[&str]) -> String {
        let panel = |state: usize, truth: usize, factor: f64| {
            let mut curves: Vec<Curve> = names
                .iter()
                .map(|name| {
                    let path = self.path(name);
                    curve(name, self.over_time(|row| Some(path.get(row)?[state] * factor)))
                })
                .collect();
            let true_ones = self.over_time(|row| Some(true_speeds(&self.table, row)?[truth] * factor));
            if !true_ones.is_empty() {
                curves.push(curve("truth", true_ones));
            }
            curves
        };
        render_figure(
            "Forward speed and turn rate",
            "figure 6 of the paper",
            vec![("v [cm/s]", panel(3, 0, 100.0)), ("w [degrees/s]", panel(4, 1, 1f64.to_degrees()))],
        )
    }

    /// Figure 7: the tracks of some methods with the reference.
    pub fn track_figure(&self, title: &str, names: &[&str]) -> String {
        let seen: Vec<(f64, f64)> =
            (self.table.references(self.camera_every).into_iter()).flatten().map(|seen| (seen.x_m, seen.y_m)).collect();
        let reference = if self.table.has_truth() { "truth" } else { "camera" };
        // Of a closed path nothing is known but its end: a line of one point would not be seen.
        let shape = if seen.len() > 1 { CurveShape::Line(seen) } else { CurveShape::Dots(seen) };
        let mut curves = vec![Curve { name: reference.to_owned(), shape }];
        curves.extend(names.iter().map(|name| {
            let path = self.path(name).iter().map(|state| (state[0], state[1]));
            curve(name, path.collect())
        }));
        render_plot(&Plot {
            title: title.to_owned(),
            key_figures: "figure 7 of the paper: x and y".to_owned(),
            axes: vec![Axes {
                x_name: "x [m]".to_owned(),
                y_name: "y [m]".to_owned(),
                height_px: 560.0,
                is_map: true,
                curves,
            }],
        })
    }

    /// The geometry that the filters were configured with.
    pub const fn geometry(&self) -> &DriveGeometry {
        &self.config.geometry
    }
}

fn render_figure(title: &str, key_figures: &str, panels: Vec<(&str, Vec<Curve>)>) -> String {
    let axes = panels.into_iter().map(|(y_name, curves)| Axes {
        x_name: "time [s]".to_owned(),
        y_name: y_name.to_owned(),
        height_px: 220.0,
        is_map: false,
        curves,
    });
    render_plot(&Plot { title: title.to_owned(), key_figures: key_figures.to_owned(), axes: axes.collect() })
}
