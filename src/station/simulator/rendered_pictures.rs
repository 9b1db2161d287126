//! The pictures of a simulated camera, rendered on a thread of their own and served as a network camera serves them.

use std::net::{SocketAddr, TcpListener};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

use anyhow::{Context, Result};
use posebridge_camera::PictureServer;
use posebridge_link::HostTimer;
use posebridge_sim::Simulation;
use posebridge_sim::rendered_camera::{Exposure, RenderedCamera};
use posebridge_sim::scenario::RenderedCameraSettings;
use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};

/// Exposures that wait for the renderer, beside those whose pictures are not due yet; a computer that is too slow drops the next ones.
const WAITING_EXPOSURES: usize = 2;

/// A camera that renders. It ends when it is dropped.
pub struct RenderedPictures {
    address: SocketAddr,
    exposures: SyncSender<(Timestamp<HostClock>, Exposure)>,
    dropped: u64,
}

impl RenderedPictures {
    /// Serves the pictures of a camera at a bound address.
    pub fn start(
        listener: TcpListener,
        settings: &RenderedCameraSettings,
        seed: u64,
        timer: HostTimer,
    ) -> Result<Self> {
        let camera = RenderedCamera::new(settings, seed).context("the simulated camera")?;
        let server = PictureServer::start(listener).context("serving the pictures of the simulated camera")?;
        let address = server.address();
        let latency_s = (settings.latency_ms + settings.jitter_ms) / 1e3;
        let (exposures, taken) = sync_channel((latency_s * settings.rate_hz).ceil() as usize + WAITING_EXPOSURES);
        std::thread::Builder::new()
            .name("renderer".to_owned())
            .spawn(move || render(camera, &server, &taken, timer))
            .context("starting the thread of the simulated camera")?;
        Ok(Self { address, exposures, dropped: 0 })
    }

    /// The URL of the pictures.
    pub fn url(&self) -> String {
        format!("http://{}/", self.address)
    }

    /// Passes on what the camera of a simulation, which began at `start`, has exposed.
    pub fn take_from(&mut self, simulation: &mut Simulation, start: Timestamp<HostClock>) {
        while let Some(exposure) = simulation.take_exposure() {
            self.dropped += u64::from(self.exposures.try_send((start, exposure)).is_err());
        }
    }
}

impl Drop for RenderedPictures {
    fn drop(&mut self) {
        if self.dropped > 0 {
            tracing::warn!(
                pictures = self.dropped,
                "this computer was too slow to render all pictures of the simulated camera"
            );
        }
    }
}

/// Renders until nobody exposes any more. Each picture is served when it is due.
fn render(
    mut camera: RenderedCamera,
    server: &PictureServer,
    exposures: &Receiver<(Timestamp<HostClock>, Exposure)>,
    timer: HostTimer,
) {
    // A thread without a runtime cannot wait for the host timer.
    let Ok(runtime) = tokio::runtime::Builder::new_current_thread().enable_time().build() else { return };
    while let Ok((start, exposure)) = exposures.recv() {
        let frame = camera.take_picture(&exposure);
        runtime.block_on(timer.sleep_until(start + TimeDelta::from_nanos(frame.due.as_nanos())));
        server.publish(frame.jpeg);
    }
}
