//! Keeps the pictures of a camera: files, and a table of their times. `camera:FOLDER` plays them again.

use std::fs::{self, File};
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;

use posebridge_telemetry::{HostClock, Timestamp};

use crate::recorded::TIMES_FILE;

/// Pictures that wait for the disk; more are not kept.
const MAX_WAITING: usize = 16;

/// A thread that writes pictures into a folder. It ends with the last clone of its owner, when all are written.
#[derive(Debug)]
pub struct PictureSaver {
    /// `None` once it ends.
    waiting: Option<SyncSender<KeptPicture>>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Debug)]
struct KeptPicture {
    at: Timestamp<HostClock>,
    bytes: Arc<[u8]>,
}

impl PictureSaver {
    /// Creates the folder. `on_failure` is called when the disk refuses a picture; none is kept from then on.
    pub fn start(folder: &Path, on_failure: impl FnOnce(io::Error) + Send + 'static) -> io::Result<Self> {
        fs::create_dir_all(folder)?;
        let mut times = File::create(folder.join(TIMES_FILE))?;
        writeln!(times, "file,time_s")?;
        let (sender, receiver) = sync_channel(MAX_WAITING);
        let folder = folder.to_owned();
        let write = move || {
            if let Err(error) = write_all(&folder, &mut times, &receiver) {
                on_failure(error);
            }
        };
        let thread = std::thread::Builder::new().name("pictures".to_owned()).spawn(write)?;
        Ok(Self { waiting: Some(sender), thread: Some(thread) })
    }

    /// False if the picture is not kept, because the disk is slower than the camera.
    pub(crate) fn save(&self, at: Timestamp<HostClock>, bytes: &Arc<[u8]>) -> bool {
        let picture = KeptPicture { at, bytes: Arc::clone(bytes) };
        self.waiting.as_ref().is_some_and(|waiting| waiting.try_send(picture).is_ok())
    }
}

impl Drop for PictureSaver {
    fn drop(&mut self) {
        self.waiting = None;
        if let Some(thread) = self.thread.take() {
            // A thread that panicked has nothing left to write.
            drop(thread.join());
        }
    }
}

fn write_all(folder: &Path, times: &mut File, pictures: &Receiver<KeptPicture>) -> io::Result<()> {
    for (number, KeptPicture { at, bytes }) in (1..).zip(pictures) {
        let name: PathBuf = format!("{number:06}.{}", ending(&bytes)).into();
        fs::write(folder.join(&name), &bytes)?;
        writeln!(times, "{},{:.6}", name.display(), at.as_secs_f64())?;
    }
    Ok(())
}

const fn ending(bytes: &[u8]) -> &'static str {
    match bytes {
        [0xFF, 0xD8, ..] => "jpg",
        [0x89, ..] => "png",
        _ => "pgm",
    }
}
