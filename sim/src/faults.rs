//! Faults that a person causes: carries the robot elsewhere, or takes the grip of its wheels.
//!
//! # Model
//! ```text
//! carried    0.1 s along a straight line, turned evenly; the wheels spin in the air and count, the gyro feels the turn
//! no grip    of each step's rotation the share that is lost turns the shaft and moves nothing
//! ```

use posebridge_telemetry::{Arena, Body, Heading, Meters, Pose, SlippingWheel, TimeDelta, Transform2};

use crate::time_step::STEP;
use crate::wheels::PerWheel;

/// A quick hand: so short that a camera of 10 images per second sees the robot in the air once at most. A turn of more than 36 degrees is
/// then faster than the gyros of the bundled scenarios can measure (360 degrees per second), as it would be in a hand.
const CARRIED_STEPS: u32 = 100;

/// Where a robot is put down, relative to where it stood. A plain turn, because a half turn may go either way round.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Displacement {
    pub(crate) forward_m: f64,
    pub(crate) left_m: f64,
    pub(crate) turn_rad: f64,
}

/// A robot in a hand.
#[derive(Clone, Copy, Debug)]
struct CarriedRobot {
    from: Pose<Arena>,
    by: Displacement,
    steps: u32,
}

/// The grip of one wheel while it has lost some.
#[derive(Clone, Copy, Debug, Default)]
struct GripLoss {
    share: f64,
    steps_left: i64,
}

impl GripLoss {
    /// The share of its rotation that reaches the floor in the next step.
    const fn next(&mut self) -> f64 {
        if self.steps_left <= 0 {
            return 1.0;
        }
        self.steps_left -= 1;
        1.0 - self.share
    }
}

/// What is being done to the robot.
#[derive(Clone, Debug, Default)]
pub(crate) struct RobotFaults {
    carried: Option<CarriedRobot>,
    lost_grip: PerWheel<GripLoss>,
}

impl RobotFaults {
    /// Lifts the robot, which stands at `from`.
    pub(crate) const fn lift(&mut self, from: Pose<Arena>, by: Displacement) {
        let steps = 0;
        self.carried = Some(CarriedRobot { from, by, steps });
    }

    /// Takes this share of the grip of a wheel for a while.
    pub(crate) fn reduce_grip(&mut self, wheel: SlippingWheel, share: f64, duration: TimeDelta) {
        let lost = GripLoss { share, steps_left: duration.as_nanos() / STEP.as_nanos() };
        let wheels = &mut self.lost_grip;
        match wheel {
            SlippingWheel::Left => wheels.left = lost,
            SlippingWheel::Right => wheels.right = lost,
            SlippingWheel::Both => *wheels = PerWheel { left: lost, right: lost },
        }
    }

    /// The share of each wheel's rotation that reaches the floor in the next step.
    pub(crate) fn grip(&mut self) -> PerWheel<f64> {
        self.lost_grip.as_mut().map(GripLoss::next)
    }

    /// Carries a lifted robot on by one step: where it is, and by how much it turned, in radians.
    pub(crate) fn step_carried(&mut self) -> Option<(Pose<Arena>, f64)> {
        let carried = self.carried.as_mut()?;
        carried.steps += 1;
        let share = f64::from(carried.steps) / f64::from(CARRIED_STEPS);
        let way = Transform2::<Body, Body>::new(
            Meters(carried.by.forward_m * share),
            Meters(carried.by.left_m * share),
            Heading::from_rad(carried.by.turn_rad * share),
        );
        let moved = (carried.from * way, carried.by.turn_rad / f64::from(CARRIED_STEPS));
        if carried.steps >= CARRIED_STEPS {
            self.carried = None;
        }
        Some(moved)
    }
}
