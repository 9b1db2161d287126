//! Brick and station in one loop, in virtual time: no link, no thread, no clock, the same every time.
//!
//! It drives the same simulation and the same pipeline as a live run, with a link that delivers at once. Used where two ways of
//! steering are compared on the same world, and by tests.

use posebridge_pipeline::{BuildError, Pipeline, PipelineConfig};
use posebridge_sim::{Scenario, Simulation};
use posebridge_telemetry::{HostClock, Input, LinkId, LinkState, Output, PeerId, Span, Stamp};

use crate::collect::Collector;

/// The brick still talks for this long after its path has ended.
const AFTERGLOW: Span = Span::from_millis(600);
/// A scenario that does not end by itself is ended here.
const LONGEST: Span = Span::from_millis(3_600_000);

/// What a virtual run leaves behind.
pub struct VirtualRun {
    /// The simulation with its truth.
    pub simulation: Simulation,
    /// What the station told.
    pub collector: Collector,
}

/// Runs a scenario against a pipeline whose first link is the brick's.
///
/// # Errors
/// The pipeline cannot be built.
pub fn run(scenario: Scenario, config: PipelineConfig) -> Result<VirtualRun, BuildError> {
    let link = config.links.first().map_or(LinkId(0), |link| link.id);
    let mut pipeline = Pipeline::new(config, Stamp::ZERO)?;
    let mut simulation = Simulation::new(scenario);
    let mut collector = Collector::default();
    let up = Input::Link {
        link,
        state: LinkState::Up,
    };
    give(
        &mut pipeline,
        Stamp::ZERO,
        &up,
        &mut simulation,
        &mut collector,
    );
    let mut ends_at: Option<Span> = None;
    while ends_at.is_none_or(|end| simulation.elapsed() < end) && simulation.elapsed() < LONGEST {
        simulation.step();
        let now = Stamp::<HostClock>::ZERO + simulation.elapsed();
        while let Some(bytes) = simulation.poll() {
            give(
                &mut pipeline,
                now,
                &Input::Bytes {
                    link,
                    peer: PeerId::default(),
                    bytes,
                },
                &mut simulation,
                &mut collector,
            );
        }
        if pipeline.deadline().is_some_and(|deadline| deadline <= now) {
            give(
                &mut pipeline,
                now,
                &Input::Tick,
                &mut simulation,
                &mut collector,
            );
        }
        if simulation.is_finished() && ends_at.is_none() {
            ends_at = Some(simulation.elapsed() + AFTERGLOW);
        }
    }
    Ok(VirtualRun {
        simulation,
        collector,
    })
}

fn give(
    pipeline: &mut Pipeline,
    now: Stamp<HostClock>,
    input: &Input,
    simulation: &mut Simulation,
    collector: &mut Collector,
) {
    pipeline.handle(now, input);
    while let Some(output) = pipeline.poll() {
        match output {
            Output::Transmit { bytes, .. } => simulation.receive(&bytes),
            Output::Event(event) => collector.take(&event),
        }
    }
}
