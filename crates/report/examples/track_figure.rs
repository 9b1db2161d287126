//! Writes the track figure of a made-up run to standard output:
//! `cargo run -p posebridge-report --example track_figure > track.svg`. A second word picks another figure.

#![expect(clippy::print_stdout, reason = "the picture is this program's output")]

#[path = "../tests/report/sample_run.rs"]
mod sample_run;

use posebridge_report::FIGURES;

fn main() {
    let requested = std::env::args().nth(1);
    let scene = sample_run::two_laps(7);
    let layers = scene.layers("square, two laps, camera at 2 Hz, out for 12.5 s (made-up run)");
    let name = requested.as_deref().unwrap_or("track");
    if let Some(figure) = FIGURES.iter().find(|figure| figure.name == name) {
        print!("{}", (figure.render)(&layers));
    }
}
