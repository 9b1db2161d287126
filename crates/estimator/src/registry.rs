//! The one table that names every filter.

use crate::filter::{Filter, FilterConfig};
use crate::filters::{dynamic, odometry, pose, thermometer};
use crate::papers::ekf5::{self, FixUsage, SpeedVarianceOrder};
use crate::papers::{ekf5_corrected, indirect, range_kf, ukf5, velocity_kf, wheel_kf};

/// One row of [`FILTERS`].
pub struct FilterEntry {
    /// Its name in the configuration and in reports.
    pub name: &'static str,
    /// What it is, in one line.
    pub summary: &'static str,
    /// What it estimates.
    pub quantity: EstimatedQuantity,
    /// What it does with an observation that comes late.
    pub late_data: LateDataPolicy,
    /// How it comes to know where the robot is.
    pub initialization: Initialization,
    /// Builds one.
    pub build: fn(&FilterConfig) -> Box<dyn Filter>,
}

/// What a filter estimates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EstimatedQuantity {
    /// The robot's pose, by [`Filter::estimate_at`].
    Pose,
    /// One quantity, by [`Filter::scalar_at`].
    Scalar,
}

/// How a filter comes to know where the robot is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Initialization {
    /// By the first fix, or by [`FilterConfig::start`].
    Fix,
    /// By [`FilterConfig::start`] or [`Filter::set_pose`] alone: it uses no fixes, and without either its pose is never valid.
    Start,
    /// It estimates no pose.
    NotApplicable,
}

/// What a filter does with an observation that comes late.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LateDataPolicy {
    /// It is used at its own time: the order of arrival does not matter.
    Replayed,
    /// It is used when it comes, as the paper does it.
    OnArrival,
}

/// Every filter. Adding one: a file in `filters/` (`papers/` for a published one) and a line here.
pub const FILTERS: &[FilterEntry] = &[
    FilterEntry {
        name: "odometry",
        summary: "dead reckoning by the wheels alone, as a brick does it",
        quantity: EstimatedQuantity::Pose,
        late_data: LateDataPolicy::Replayed,
        initialization: Initialization::Start,
        build: |config| Box::new(odometry::OdometryFilter::new(config)),
    },
    FilterEntry {
        name: "pose",
        summary: "error-state EKF on SE(2) that learns gyro bias, wheels and track, with exact replay of late fixes",
        quantity: EstimatedQuantity::Pose,
        late_data: LateDataPolicy::Replayed,
        initialization: Initialization::Fix,
        build: pose::build,
    },
    FilterEntry {
        name: "wheel-kf",
        summary: "paper 1: a Kalman filter per wheel, then odometry",
        quantity: EstimatedQuantity::Pose,
        late_data: LateDataPolicy::OnArrival,
        initialization: Initialization::Start,
        build: wheel_kf::build,
    },
    FilterEntry {
        name: "velocity-kf",
        summary: "paper 1: a Kalman filter for both speeds with the accelerations as input, then odometry",
        quantity: EstimatedQuantity::Pose,
        late_data: LateDataPolicy::OnArrival,
        initialization: Initialization::Start,
        build: velocity_kf::build,
    },
    FilterEntry {
        name: "ekf5",
        summary: "paper 1: pose and speeds in one EKF, with integrated headings as observations",
        quantity: EstimatedQuantity::Pose,
        late_data: LateDataPolicy::OnArrival,
        initialization: Initialization::Start,
        build: |config| ekf5::build(config, SpeedVarianceOrder::Printed, FixUsage::Unused),
    },
    FilterEntry {
        name: "ekf5-camera",
        summary: "paper 1 and its outlook: ekf5 with gated fixes, used when they come",
        quantity: EstimatedQuantity::Pose,
        late_data: LateDataPolicy::OnArrival,
        initialization: Initialization::Fix,
        build: |config| ekf5::build(config, SpeedVarianceOrder::Printed, FixUsage::Used),
    },
    FilterEntry {
        name: "ekf5-corrected",
        summary: "ekf5 with the errors of its integrated headings as states and configured noise",
        quantity: EstimatedQuantity::Pose,
        late_data: LateDataPolicy::OnArrival,
        initialization: Initialization::Start,
        build: ekf5_corrected::build,
    },
    FilterEntry {
        name: "ukf5",
        summary: "ekf5 with sigma points in place of the Jacobian",
        quantity: EstimatedQuantity::Pose,
        late_data: LateDataPolicy::OnArrival,
        initialization: Initialization::Start,
        build: ukf5::build,
    },
    FilterEntry {
        name: "dynamic",
        summary: "paper 2: the final value of a slow thermometer, from its approach",
        quantity: EstimatedQuantity::Scalar,
        late_data: LateDataPolicy::OnArrival,
        initialization: Initialization::NotApplicable,
        build: |config| Box::new(dynamic::DynamicFilter::new(config)),
    },
    FilterEntry {
        name: "dynamic-live",
        summary: "paper 2 left running: finds each new approach, and learns how slow the thermometer is",
        quantity: EstimatedQuantity::Scalar,
        late_data: LateDataPolicy::OnArrival,
        initialization: Initialization::NotApplicable,
        build: |config| {
            let settings = thermometer::ThermometerSettings::default();
            Box::new(thermometer::Thermometer::new(config, &settings))
        },
    },
    FilterEntry {
        name: "range-kf",
        summary: "paper 3: distance to a wall from time of flight and motor input, as printed",
        quantity: EstimatedQuantity::Scalar,
        late_data: LateDataPolicy::OnArrival,
        initialization: Initialization::NotApplicable,
        build: |config| Box::new(range_kf::RangeFilter::new(config, range_kf::RangeFilterVariant::Paper)),
    },
    FilterEntry {
        name: "range-kf-corrected",
        summary: "paper 3 with noise per second, an exact hold and readings at their own time",
        quantity: EstimatedQuantity::Scalar,
        late_data: LateDataPolicy::OnArrival,
        initialization: Initialization::NotApplicable,
        build: |config| Box::new(range_kf::RangeFilter::new(config, range_kf::RangeFilterVariant::Corrected)),
    },
    FilterEntry {
        name: "indirect",
        summary: "paper 4: errors of the wheels' path by accelerometers and gyro, fed forward",
        quantity: EstimatedQuantity::Pose,
        late_data: LateDataPolicy::OnArrival,
        initialization: Initialization::Fix,
        build: |config| {
            let correction = indirect::CorrectionMode::FeedForward;
            Box::new(indirect::IndirectFilter::new(config, correction))
        },
    },
    FilterEntry {
        name: "indirect-feedback",
        summary: "the same with the errors fed back into the path",
        quantity: EstimatedQuantity::Pose,
        late_data: LateDataPolicy::OnArrival,
        initialization: Initialization::Fix,
        build: |config| {
            let correction = indirect::CorrectionMode::Feedback;
            Box::new(indirect::IndirectFilter::new(config, correction))
        },
    },
];

/// The row with this name.
pub fn find_filter(name: &str) -> Option<&'static FilterEntry> {
    FILTERS.iter().find(|entry| entry.name == name)
}
