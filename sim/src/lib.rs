//! A simulated robot: its physics, sensors, brick and an overhead camera, with the ground truth kept separate.
//!
//! A [`Scenario`] configures a [`Simulation`], which advances [`STEP`] by [`STEP`]. To a station the simulation is a
//! robot behind a link: bytes out of [`Simulation::poll`], bytes into [`Simulation::receive`], the same MAVLink as a
//! real brick. [`Simulation::truth`] is for scores and tests only.
//!
//! This crate depends on neither the estimator nor the station, so that the simulated robot is independent of what it
//! tests. It reads no clock and does no input or output, and all randomness comes from the scenario's seed: the same
//! calls give the same bytes.
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

mod camera;
mod clock;
mod config_file;
mod firmware;
pub mod frame_accelerometers;
mod hand;
mod history;
pub mod impairment;
mod mavlink_node;
pub mod montecarlo;
mod motor;
pub mod motor_bench;
mod path;
mod personality;
mod random;
pub mod rendered_camera;
mod robot_body;
pub mod scenario;
mod sensors;
mod simulation;
pub mod wall;
mod wheels;

pub use camera::{CAMERA, CameraFix};
pub use clock::STEP;
pub use firmware::BRICK;
pub use history::{HISTORY_DURATION, HISTORY_TRIM_BLOCK};
pub use personality::ev3_beacon;
pub use scenario::{BUNDLED, Scenario, ScenarioError, Steering};
pub use simulation::{CommandExecutor, ReceivedEstimate, Simulation, TruthSample};
