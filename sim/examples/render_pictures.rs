//! Renders pictures of a robot on a circle and says what they cost: `render_pictures [FOLDER]` prints the CPU milliseconds of this thread
//! for each frame, and writes one picture of each size to the folder, as PGM and as JPEG.
#![expect(clippy::print_stdout, reason = "its output is its result")]

use std::error::Error;
use std::path::PathBuf;

use nix::time::{ClockId, clock_gettime};
use posebridge_sim::rendered_camera::{LensState, MovingTag, RenderedCamera, encode_jpeg};
use posebridge_sim::scenario::RenderedCameraSettings;
use posebridge_telemetry::{Arena, Heading, Meters, Pose, TimeDelta};

const FRAMES: u32 = 100;

fn main() -> Result<(), Box<dyn Error>> {
    let folder = std::env::args().nth(1).map(PathBuf::from);
    for (width_px, height_px, focal_px) in [(640, 480, 600.0), (1280, 720, 1_000.0)] {
        for line_time_us in [0.0, 30.0] {
            let settings = RenderedCameraSettings { width_px, height_px, focal_px, line_time_us, ..Default::default() };
            let (camera, still_ms) = timed(|| RenderedCamera::new(&settings, 1))?;
            let mut camera = camera?;
            let (mut render_ms, mut jpeg_ms) = (Vec::new(), Vec::new());
            for number in 0..FRAMES {
                let mid = TimeDelta::from_secs_f64(f64::from(number) / settings.rate_hz);
                let mut pose = drive;
                let mut tags = [MovingTag { tag: settings.robot_tag, pose: &mut pose }];
                let (_, ms) = timed(|| camera.render(number.into(), mid, LensState::Open, &mut tags).len())?;
                render_ms.push(ms);
                let pixels = camera.render(number.into(), mid, LensState::Open, &mut tags);
                let (jpeg, ms) = timed(|| encode_jpeg(pixels, width_px, height_px, settings.jpeg_quality))?;
                jpeg_ms.push(ms);
                if let Some(folder) = folder.as_ref().filter(|_| number == 0 && line_time_us == 0.0) {
                    let header = format!("P5 {width_px} {height_px} 255\n");
                    std::fs::write(folder.join(format!("{width_px}.pgm")), [header.as_bytes(), pixels].concat())?;
                    std::fs::write(folder.join(format!("{width_px}.jpg")), jpeg.unwrap_or_default())?;
                }
            }
            println!(
                "{width_px} x {height_px}, {line_time_us} us a line: still {still_ms:.0} ms, frame {}, JPEG {}",
                spread(&mut render_ms),
                spread(&mut jpeg_ms)
            );
        }
    }
    Ok(())
}

/// A circle at 0.3 m/s.
fn drive(time: TimeDelta) -> Pose<Arena> {
    let angle = 0.75 * time.as_secs_f64();
    Pose::new(
        Meters(0.5 + 0.4 * angle.cos()),
        Meters(0.5 + 0.4 * angle.sin()),
        Heading::from_rad(angle + std::f64::consts::FRAC_PI_2),
    )
}

fn spread(ms: &mut [f64]) -> String {
    ms.sort_by(f64::total_cmp);
    let last = ms.len() - 1;
    format!("median {:.2} ms, worst {:.2} ms", ms[last / 2], ms[last])
}

/// The result, and the CPU time of this thread, ms.
fn timed<T>(work: impl FnOnce() -> T) -> Result<(T, f64), nix::Error> {
    let now = || clock_gettime(ClockId::CLOCK_THREAD_CPUTIME_ID);
    let ms = |time: nix::sys::time::TimeSpec| time.tv_sec() as f64 * 1e3 + time.tv_nsec() as f64 / 1e6;
    let begun = now()?;
    let result = work();
    Ok((result, ms(now()?) - ms(begun)))
}
