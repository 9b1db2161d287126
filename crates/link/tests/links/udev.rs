//! A computer in a folder: what udev and the kernel show of the serial adapters that are plugged in.

use std::fs;
use std::os::unix::fs::symlink;
use std::path::Path;

use posebridge_link::DeviceDirectories;

/// Where an adapter is plugged in, and its identification.
#[derive(Clone, Copy)]
pub(crate) struct PluggedAdapter<'a> {
    pub(crate) socket: &'a str,
    /// udev's name for its kind, with its serial number if it has one.
    pub(crate) id: &'a str,
    pub(crate) serial: Option<&'a str>,
}

/// The directories of a computer whose folder is `root`.
pub(crate) fn directories(root: &Path) -> DeviceDirectories {
    DeviceDirectories {
        serial_by_id: root.join("by-id"),
        serial_by_path: root.join("by-path"),
        tty_class: root.join("tty"),
        usb_serial: root.join("usb-serial"),
    }
}

/// Makes the entries of an adapter that is called `name`; both of udev's links lead to it then.
pub(crate) fn plug_in(root: &Path, name: &str, plug: PluggedAdapter<'_>) {
    let usb = root.join("usb").join(plug.socket);
    let class = root.join("tty").join(name);
    for directory in [&usb, &class] {
        drop(fs::remove_dir_all(directory));
    }
    for directory in [&usb.join("1.0"), &class] {
        fs::create_dir_all(directory).expect("own directory");
    }
    let ids = [("idVendor", "1a86\n"), ("idProduct", "7523\n")];
    for (file, value) in ids.into_iter().chain(plug.serial.map(|serial| ("serial", serial))) {
        fs::write(usb.join(file), value).expect("own directory");
    }
    symlink(usb.join("1.0"), class.join("device")).expect("a free name");
    for (directory, link) in [("by-id", plug.id), ("by-path", plug.socket)] {
        let directory = root.join(directory);
        fs::create_dir_all(&directory).expect("own directory");
        drop(fs::remove_file(directory.join(link)));
        symlink(root.join(name), directory.join(link)).expect("a free name");
    }
}
