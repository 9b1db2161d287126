//! The drives of paper 4's square, with accelerometers on the frame, and the paper's own figure.

use posebridge_sim::frame_accelerometers::FrameAccelerometers;
use posebridge_sim::montecarlo::{Drive, Scenario};

/// End error of the paper's own run, in x and y: the reference for the fused ends.
pub(super) const PAPER_END_M: (f64, f64) = (0.235, 0.32);
/// Residual accelerometer bias after zeroing by eye: 5 mg; docs/lab/indirect.md section M4.
const BIAS_SIGMA_M_PER_S2: f64 = 0.05;

pub(super) fn draw_drive(scenario: &Scenario, run: u32) -> Drive {
    let drive = scenario.drive(run);
    let Some(settings) = scenario.accelerometer else {
        return drive;
    };
    let accelerometers = FrameAccelerometers {
        sigma_m_per_s2: settings.sigma_m_per_s2,
        bias_sigma_m_per_s2: BIAS_SIGMA_M_PER_S2,
        spacing: drive.prior.geometry.track_width,
    };
    accelerometers.add_to(drive, scenario.seed, run)
}
