//! The one table that names every filter.

use crate::filter::{Filter, FilterConfig};
use crate::filters::dynamic::DynamicFilter;
use crate::filters::odometry::OdometryFilter;
use crate::filters::pose;
use crate::filters::thermometer::{Thermometer, ThermometerSettings};
use crate::papers::ekf5::{self, FixUsage};
use crate::papers::indirect::{CorrectionMode, IndirectFilter};
use crate::papers::paper1::{FiveStateMatrices, SpeedMatrices, WheelMatrices};
use crate::papers::range_kf::{RangeFilter, RangeFilterVariant};
use crate::papers::wheel_kf::{self, WheelOdometry};
use crate::papers::{ekf5_corrected, ukf5, velocity_kf};

/// One row of [`FILTERS`].
pub struct FilterEntry {
    /// Its name in the configuration and in reports.
    pub name: &'static str,
    pub summary: &'static str,
    pub quantity: EstimatedQuantity,
    pub late_data: LateDataPolicy,
    pub initialization: Initialization,
    pub build: fn(&FilterConfig) -> Box<dyn Filter>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EstimatedQuantity {
    Pose,
    /// The final value of a slow sensor.
    Temperature,
    /// The distance to a wall ahead.
    WallDistance,
}

/// How a filter gets its first pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Initialization {
    /// By the first fix, or by [`FilterConfig::start`].
    Fix,
    /// By [`FilterConfig::start`] or [`Filter::set_pose`] alone: it uses no fixes, and without either its pose is never valid.
    Start,
    /// It estimates no pose.
    NotApplicable,
}

/// The treatment of late observations.
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
        build: |config| Box::new(OdometryFilter::new(config)),
    },
    FilterEntry {
        name: "pose",
        summary: "error-state EKF on SE(2) that learns gyro bias, wheels and track, with exact replay of late fixes",
        quantity: EstimatedQuantity::Pose,
        late_data: LateDataPolicy::Replayed,
        initialization: Initialization::Fix,
        build: pose::build,
    },
    FilterEntry::of_paper(
        "wheel-kf",
        "paper 1: a Kalman filter per wheel, then odometry by the filtered angles",
        Initialization::Start,
        |config| wheel_kf::build(config, &WheelMatrices::AS_PRINTED, WheelOdometry::Angles),
    ),
    FilterEntry::of_paper(
        "wheel-kf-speeds",
        "paper 1: the same with odometry by the filtered speeds",
        Initialization::Start,
        |config| wheel_kf::build(config, &WheelMatrices::AS_PRINTED, WheelOdometry::Speeds),
    ),
    FilterEntry::of_paper(
        "velocity-kf",
        "paper 1: a Kalman filter for both speeds with the accelerations as input, then odometry",
        Initialization::Start,
        |config| velocity_kf::build(config, &SpeedMatrices::AS_PRINTED),
    ),
    FilterEntry::of_paper(
        "ekf5",
        "paper 1: pose and speeds in one EKF, with integrated headings as observations",
        Initialization::Start,
        |config| ekf5::build(config, &FiveStateMatrices::AS_PRINTED, FixUsage::Unused),
    ),
    FilterEntry::of_paper(
        "ekf5-camera",
        "paper 1 and its outlook: ekf5 with gated fixes, used when they come",
        Initialization::Fix,
        |config| ekf5::build(config, &FiveStateMatrices::AS_PRINTED, FixUsage::Used),
    ),
    FilterEntry::of_paper(
        "ekf5-corrected",
        "ekf5 with the errors of its integrated headings as states and configured noise",
        Initialization::Start,
        ekf5_corrected::build,
    ),
    FilterEntry::of_paper(
        "ekf5-camera-corrected",
        "the same with fixes, and with a recovery from fixes that the gate rejects",
        Initialization::Fix,
        ekf5_corrected::build_with_camera,
    ),
    FilterEntry::of_paper(
        "ukf-all",
        "paper 1's outlook in one filter: the same by sigma points, with a compass and its deviation",
        Initialization::Fix,
        ekf5_corrected::build_with_all_sensors,
    ),
    FilterEntry::of_paper(
        "ukf5",
        "ekf5 with sigma points in place of the Jacobian",
        Initialization::Start,
        ukf5::build,
    ),
    FilterEntry::of_one_quantity(
        "dynamic",
        "paper 2: the final value of a slow thermometer, from its approach",
        EstimatedQuantity::Temperature,
        |config| Box::new(DynamicFilter::new(config)),
    ),
    FilterEntry::of_one_quantity(
        "dynamic-live",
        "paper 2 left running: finds each new approach, and learns how slow the thermometer is",
        EstimatedQuantity::Temperature,
        |config| Box::new(Thermometer::new(config, &ThermometerSettings::from_config(config))),
    ),
    FilterEntry::of_one_quantity(
        "range-kf",
        "paper 3: distance to a wall from time of flight and motor input, as printed",
        EstimatedQuantity::WallDistance,
        |config| Box::new(RangeFilter::new(config, RangeFilterVariant::Paper)),
    ),
    FilterEntry::of_one_quantity(
        "range-kf-corrected",
        "paper 3 with noise per second, an exact hold and readings at their own time",
        EstimatedQuantity::WallDistance,
        |config| Box::new(RangeFilter::new(config, RangeFilterVariant::Corrected)),
    ),
    FilterEntry::of_paper(
        "indirect",
        "paper 4: errors of the wheels' path by accelerometers and gyro, fed forward",
        Initialization::Fix,
        |config| Box::new(IndirectFilter::new(config, CorrectionMode::FeedForward)),
    ),
    FilterEntry::of_paper(
        "indirect-feedback",
        "the same with the errors fed back into the path",
        Initialization::Fix,
        |config| Box::new(IndirectFilter::new(config, CorrectionMode::Feedback)),
    ),
];

impl FilterEntry {
    /// A pose filter of a paper, which uses observations when they come.
    const fn of_paper(
        name: &'static str,
        summary: &'static str,
        initialization: Initialization,
        build: fn(&FilterConfig) -> Box<dyn Filter>,
    ) -> Self {
        let (quantity, late_data) = (EstimatedQuantity::Pose, LateDataPolicy::OnArrival);
        Self { name, summary, quantity, late_data, initialization, build }
    }

    const fn of_one_quantity(
        name: &'static str,
        summary: &'static str,
        quantity: EstimatedQuantity,
        build: fn(&FilterConfig) -> Box<dyn Filter>,
    ) -> Self {
        let late_data = LateDataPolicy::OnArrival;
        Self { name, summary, quantity, late_data, initialization: Initialization::NotApplicable, build }
    }
}

pub fn find_filter(name: &str) -> Option<&'static FilterEntry> {
    FILTERS.iter().find(|entry| entry.name == name)
}
