//! A simulated robot: its physics, its sensors, its brick and an overhead camera, with the truth kept apart.
//!
//! A [`Scenario`] says what happens; a [`Simulation`] lets it happen, [`STEP`] by [`STEP`]. To a
//! station the simulation is a robot behind a link: bytes out of [`Simulation::poll`], bytes into
//! [`Simulation::receive`], the same MAVLink as a real brick. [`Simulation::truth`] is for scores and tests only.
//!
//! This crate names neither the estimator nor the pipeline: nobody marks their own exam. It reads no clock, opens
//! nothing, starts nothing, and all randomness comes from the scenario's seed: the same calls give the same bytes.
//!
//! ```
//! use posebridge_sim::{Scenario, Simulation};
//! let scenario = Scenario::from_toml("seed = 7\n[path.circle]\nradius_m = 0.4\n")?;
//! let mut simulation = Simulation::new(scenario);
//! let mut bytes = 0;
//! while simulation.elapsed().as_secs_f64() < 1.0 {
//!     simulation.step();
//!     while let Some(frames) = simulation.poll() {
//!         bytes += frames.len();
//!     }
//! }
//! assert!(bytes > 1_000);
//! # Ok::<(), posebridge_sim::ScenarioError>(())
//! ```

pub mod bench;
mod bundled;
mod camera;
mod checks;
mod clock;
mod firmware;
pub mod frame_accelerometers;
pub mod impairment;
mod mishaps;
pub mod montecarlo;
mod motor;
mod node;
pub mod overhead_view;
mod path;
mod personality;
mod random;
pub mod scenario;
mod sensors;
mod simulation;
mod thermometer;
pub mod wall;
mod wheels;
mod world;

pub use camera::{CAMERA, CameraFix};
pub use firmware::BRICK;
pub use personality::ev3_beacon;
pub use scenario::{BUNDLED, Scenario, ScenarioError, Steering};
pub use simulation::{Doer, FORGOTTEN_AT_ONCE, REMEMBERED, ReceivedEstimate, Simulation, TruthSample};
pub use world::STEP;
