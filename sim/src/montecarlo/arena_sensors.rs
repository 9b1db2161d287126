//! The sensors on board that measure the pose against the arena: landmarks, beacons and compass, where they sit and when they report.

use std::f64::consts::PI;

use posebridge_telemetry::quantities::wrap_rad;
use posebridge_telemetry::{BeaconId, Heading, LandmarkId, Meters, ObservationKind, Radians, SensorId, TimeDelta};

use super::observers::{DrawnValue, SensorPlace, StampErrors};
use super::plan::PlanarPose;
use super::scenario::Scenario;
use crate::random::RandomStream;

impl DrawnValue {
    fn draw(self, stream: &mut RandomStream) -> f64 {
        self.value + self.sigma * stream.normal()
    }
}

/// The errors of one source's timestamps in one run.
#[derive(Clone, Copy, Debug)]
pub(super) struct StampClock {
    offset_s: f64,
    skew_ppm: f64,
}

impl StampClock {
    /// `name` is that of the source's random streams.
    pub(super) fn new(errors: StampErrors, name: &str, seed: u64) -> Self {
        let mut stream = RandomStream::new(seed, &format!("{name} stamps"));
        Self { offset_s: errors.offset_s.draw(&mut stream), skew_ppm: errors.skew_ppm.draw(&mut stream) }
    }

    /// How much later than the measurement its timestamp is.
    pub(super) fn late_by(&self, measured_s: f64) -> TimeDelta {
        TimeDelta::from_secs_f64(self.offset_s + self.skew_ppm * 1e-6 * measured_s)
    }
}

/// A measurement on its way to the filter.
#[derive(Clone, Copy, Debug)]
pub(super) struct PendingMeasurement {
    pub(super) taken_step: usize,
    pub(super) observed: ObservationKind,
}

/// What a sensor measures at this pose of its own.
enum Sensing {
    Landmarks { points_m: Vec<[f64; 2]>, half_view_rad: f64, bearing_sigma_rad: f64, ranging: Ranging },
    Beacons { points_m: Vec<[f64; 2]>, errors: Vec<RangeError>, ranging: Ranging },
    Compass { sigma_rad: f64 },
}

struct Ranging {
    sigma_m: f64,
    share: f64,
    max_m: f64,
}

/// Constant and relative error of the ranges to one beacon.
struct RangeError {
    offset_m: f64,
    scale: f64,
}

pub(super) struct ArenaSensor {
    pub(super) id: SensorId,
    pub(super) stamps: StampClock,
    sensing: Sensing,
    /// In the body's frame.
    place: PlanarPose,
    every_steps: usize,
    delay_steps: usize,
    noise: RandomStream,
    /// Oldest first.
    pending: Vec<PendingMeasurement>,
}

impl ArenaSensor {
    /// Those of a scenario.
    pub(super) fn all(scenario: &Scenario, seed: u64) -> Vec<Self> {
        let landmarks = scenario.landmarks.as_ref().map(|sensor| {
            let mut map = RandomStream::new(seed, "landmark map");
            let points_m =
                sensor.positions_m.iter().map(|at| at.map(|along_m| along_m + sensor.map_sigma_m * map.normal()));
            let sensing = Sensing::Landmarks {
                points_m: points_m.collect(),
                half_view_rad: 0.5 * sensor.field_of_view_deg.to_radians(),
                bearing_sigma_rad: sensor.bearing_sigma_deg.to_radians(),
                ranging: Ranging {
                    sigma_m: sensor.range_sigma_m,
                    share: sensor.range_share,
                    max_m: sensor.max_range_m,
                },
            };
            let timing = [sensor.every_steps, sensor.delay_steps];
            Self::new(SensorId::LANDMARKS, "landmarks", sensing, sensor.mounting, sensor.stamps, timing, seed)
        });
        let beacons = scenario.beacons.as_ref().map(|sensor| {
            let mut stream = RandomStream::new(seed, "beacon errors");
            let errors = sensor.positions_m.iter().map(|_| RangeError {
                offset_m: sensor.offset_sigma_m * stream.normal(),
                scale: sensor.scale_sigma * stream.normal(),
            });
            let sensing = Sensing::Beacons {
                points_m: sensor.positions_m.clone(),
                errors: errors.collect(),
                ranging: Ranging {
                    sigma_m: sensor.range_sigma_m,
                    share: sensor.range_share,
                    max_m: sensor.max_range_m,
                },
            };
            let timing = [sensor.every_steps, sensor.delay_steps];
            Self::new(SensorId::BEACONS, "beacons", sensing, sensor.mounting, sensor.stamps, timing, seed)
        });
        let compass = scenario.compass.as_ref().map(|sensor| {
            let sensing = Sensing::Compass { sigma_rad: sensor.heading_sigma_deg.to_radians() };
            let timing = [sensor.every_steps, sensor.delay_steps];
            Self::new(SensorId::COMPASS, "compass", sensing, sensor.mounting, sensor.stamps, timing, seed)
        });
        [landmarks, beacons, compass].into_iter().flatten().collect()
    }

    fn new(
        id: SensorId,
        name: &str,
        sensing: Sensing,
        place: SensorPlace,
        stamps: StampErrors,
        [every_steps, delay_steps]: [u32; 2],
        seed: u64,
    ) -> Self {
        let mut mounting = RandomStream::new(seed, &format!("{name} mounting"));
        let place = PlanarPose {
            x_m: place.x_m.draw(&mut mounting),
            y_m: place.y_m.draw(&mut mounting),
            heading_rad: wrap_rad(place.yaw_deg.draw(&mut mounting).to_radians()),
        };
        Self {
            id,
            stamps: StampClock::new(stamps, name, seed),
            sensing,
            place,
            every_steps: every_steps as usize,
            delay_steps: delay_steps as usize,
            noise: RandomStream::new(seed, name),
            pending: Vec::new(),
        }
    }

    pub(super) fn observe(&mut self, step: usize, robot: &PlanarPose) {
        if !step.is_multiple_of(self.every_steps) {
            return;
        }
        let sensor = robot.compose(self.place);
        let measured = self.sensing.measure(&sensor, &mut self.noise);
        self.pending.extend(measured.into_iter().map(|observed| PendingMeasurement { taken_step: step, observed }));
    }

    /// What arrives at a step.
    pub(super) fn arrivals(&mut self, step: usize) -> Vec<PendingMeasurement> {
        let due = self.pending.partition_point(|measured| measured.taken_step + self.delay_steps <= step);
        self.pending.drain(..due).collect()
    }
}

impl Sensing {
    /// Takes as many draws whatever is in view.
    fn measure(&self, sensor: &PlanarPose, noise: &mut RandomStream) -> Vec<ObservationKind> {
        match self {
            Self::Landmarks { points_m, half_view_rad, bearing_sigma_rad, ranging } => {
                let seen = (0..).zip(points_m).filter_map(|(id, point_m)| {
                    let (range_m, bearing_rad) = towards(sensor, point_m);
                    let measured_m = ranging.measure(range_m, noise);
                    let measured_rad = wrap_rad(bearing_rad + bearing_sigma_rad * noise.normal());
                    // A scanner that sees all round has no edge.
                    let is_in_view = *half_view_rad >= PI || bearing_rad.abs() <= *half_view_rad;
                    measured_m.filter(|_| is_in_view).map(|range_m| ObservationKind::Landmark {
                        id: LandmarkId(id),
                        range: Meters(range_m),
                        bearing: Radians(measured_rad),
                    })
                });
                seen.collect()
            }
            Self::Beacons { points_m, errors, ranging } => {
                let heard = (0..).zip(points_m.iter().zip(errors)).filter_map(|(id, (point_m, error))| {
                    let (range_m, _) = towards(sensor, point_m);
                    let measured_m = ranging.measure(range_m, noise)?;
                    let range = Meters((measured_m + range_m * error.scale + error.offset_m).max(0.0));
                    Some(ObservationKind::BeaconRange { id: BeaconId(id), range })
                });
                heard.collect()
            }
            Self::Compass { sigma_rad } => {
                vec![ObservationKind::CompassHeading(Heading::from_rad(
                    sensor.heading_rad + sigma_rad * noise.normal(),
                ))]
            }
        }
    }
}

impl Ranging {
    /// `None` out of reach.
    fn measure(&self, range_m: f64, noise: &mut RandomStream) -> Option<f64> {
        let sigma_m = self.sigma_m.hypot(self.share * range_m);
        let measured_m = (range_m + sigma_m * noise.normal()).max(0.0);
        (range_m <= self.max_m).then_some(measured_m)
    }
}

/// Range, m, and bearing, rad, of a point.
fn towards(sensor: &PlanarPose, point_m: &[f64; 2]) -> (f64, f64) {
    let (dx_m, dy_m) = (point_m[0] - sensor.x_m, point_m[1] - sensor.y_m);
    (dx_m.hypot(dy_m), wrap_rad(dy_m.atan2(dx_m) - sensor.heading_rad))
}
