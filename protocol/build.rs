//! Generates the types of our own dialect from `definitions/posebridge.xml`.

use std::env;
use std::error::Error;
use std::path::Path;

use mavlink_bindgen::XmlDefinitions;

fn main() -> Result<(), Box<dyn Error>> {
    let manifest_dir = env::var("CARGO_MANIFEST_DIR")?;
    let definition = Path::new(&manifest_dir).join("definitions/posebridge.xml");
    println!("cargo::rerun-if-changed={}", definition.display());
    // The generated code offers features that this crate does not have; declaring them keeps the compiler quiet.
    println!(
        "cargo::rustc-check-cfg=cfg(feature, values(\"serde\", \"arbitrary\", \"ts-rs\", \"dialect-posebridge\"))"
    );
    // The generated module is gated on this name; it is not a choice of the user.
    println!("cargo::rustc-cfg=feature=\"dialect-posebridge\"");
    mavlink_bindgen::generate(XmlDefinitions::Files(vec![definition]), env::var("OUT_DIR")?)?;
    Ok(())
}
