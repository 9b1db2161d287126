//! Which camera stands behind a path: its driver's name for it, and the ids and serial number of USB.
//!
//! Source: Linux kernel documentation, sysfs of video4linux and of USB devices.

use std::fs;
use std::path::{Path, PathBuf};

use posebridge_link::LinkUrl;

const VIDEO_DEVICES: &str = "/sys/class/video4linux";

/// The identity of the webcam of a link, such as `HD Pro Webcam C920 (046d:082d, serial 3A1B)`; `None` of another source, or while it is
/// not plugged in.
pub fn device_identity(url: &LinkUrl) -> Option<String> {
    identity_below(Path::new(VIDEO_DEVICES), url.path())
}

/// As the driver of a webcam calls it; `None` of another file.
pub(crate) fn device_name(path: &Path) -> Option<String> {
    read(&folder_of(Path::new(VIDEO_DEVICES), path)?.join("name"))
}

/// The name of the driver of a webcam.
pub(crate) fn driver_of(path: &Path) -> Option<String> {
    let driver = folder_of(Path::new(VIDEO_DEVICES), path)?.join("device/driver").canonicalize().ok()?;
    Some(driver.file_name()?.to_string_lossy().into_owned())
}

/// A link below /dev/v4l/by-id leads to the node.
fn folder_of(devices: &Path, path: &Path) -> Option<PathBuf> {
    Some(devices.join(path.canonicalize().ok()?.file_name()?))
}

fn identity_below(devices: &Path, path: &Path) -> Option<String> {
    let device = folder_of(devices, path)?;
    let name = read(&device.join("name"))?;
    // The node's device is an interface of the USB device.
    let usb = device.join("device/..");
    let ids = read(&usb.join("idVendor"))
        .zip(read(&usb.join("idProduct")))
        .map(|(vendor, product)| format!("{vendor}:{product}"));
    let serial = read(&usb.join("serial")).map(|serial| format!("serial {serial}"));
    let more: Vec<String> = ids.into_iter().chain(serial).collect();
    Some(if more.is_empty() { name } else { format!("{name} ({})", more.join(", ")) })
}

fn read(path: &Path) -> Option<String> {
    fs::read_to_string(path).ok().map(|text| text.trim().to_owned()).filter(|text| !text.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_webcam_is_known_by_its_name_and_what_usb_says_of_it() {
        let folder = tempfile::tempdir().unwrap();
        let [nodes, devices, usb] = ["dev", "class", "bus/1-1"].map(|part| folder.path().join(part));
        let interface = usb.join("1-1:1.0");
        for part in [&nodes, &interface, &devices.join("video2"), &devices.join("video3")] {
            fs::create_dir_all(part).unwrap();
        }
        fs::write(nodes.join("video2"), "").unwrap();
        fs::write(nodes.join("video3"), "").unwrap();
        std::os::unix::fs::symlink(nodes.join("video2"), nodes.join("by-id")).unwrap();
        std::os::unix::fs::symlink(&interface, devices.join("video2/device")).unwrap();
        fs::write(devices.join("video2/name"), "HD Pro Webcam C920\n").unwrap();
        fs::write(devices.join("video3/name"), "vivid\n").unwrap();
        for (file, text) in [("idVendor", "046d\n"), ("idProduct", "082d\n"), ("serial", "3A1B\n")] {
            fs::write(usb.join(file), text).unwrap();
        }
        let identity = |node: &str| identity_below(&devices, &nodes.join(node));
        assert_eq!(identity("by-id").as_deref(), Some("HD Pro Webcam C920 (046d:082d, serial 3A1B)"));
        assert_eq!(identity("video3").as_deref(), Some("vivid"));
        assert_eq!(identity("video9"), None);
    }
}
