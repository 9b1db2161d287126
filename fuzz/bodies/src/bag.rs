//! Bags of ROS 2: any bytes end in topics or a refusal, and what is chosen of them can be loaded.

use posebridge_recording::ros2::bag::{BagPlan, BagSummary, WheelGeometry};
use posebridge_telemetry::ObservationKind;

use crate::dataset::load_file;

/// Input: one byte that says whether the wheels are known, then the file.
pub(crate) fn check(data: &[u8]) {
    let [options, file @ ..] = data else {
        return;
    };
    let Ok(summary) = BagSummary::read(file) else {
        return;
    };
    let geometry = if options & 1 == 0 { WheelGeometry::Unknown } else { WheelGeometry::Known };
    let messages: u64 = summary.topics.iter().map(|topic| topic.messages).sum();
    let Ok(plan) = BagPlan::new(&summary, "bag", "bag.mcap", geometry) else {
        return;
    };
    let run = match load_file(&plan.descriptor, "bag", file) {
        Ok(run) => run,
        Err(error) => panic!("{error} of {}", plan.descriptor),
    };
    assert!(run.observations.iter().count() as u64 <= messages);
    for timed in run.observations.iter() {
        if let ObservationKind::WallRange(range) = timed.observation.measurement {
            assert!(range.0.is_finite() && range.0 >= 0.0, "{timed:?}");
        }
    }
}
