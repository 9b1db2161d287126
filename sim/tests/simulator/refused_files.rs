//! The files of tests/data/refused_files.txt, which describes its format, are refused with the reason.

use posebridge_sim::impairment::LinkProfile;
use posebridge_sim::wall::{DEFAULT_SCENE, WallScene};
use posebridge_sim::{Scenario, montecarlo};

const REFUSED: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/refused_files.txt");

fn bundled(kind: &str) -> &'static str {
    let accuracy = montecarlo::SCENARIOS.iter().find(|(name, _)| *name == kind);
    accuracy.map_or(DEFAULT_SCENE, |(_, text)| text)
}

fn refusal(kind: &str, text: &str) -> String {
    match kind {
        "scenario" => Scenario::from_toml(text).unwrap_err().to_string(),
        "waypoints" => {
            let scenario = "[path.waypoints]\nfile = \"lap/points.csv\"\n";
            Scenario::from_toml_with(scenario, &mut |_| Ok(text.to_owned())).unwrap_err().to_string()
        }
        "profile" => LinkProfile::from_toml(text).unwrap_err().to_string(),
        "wall" => WallScene::from_toml(text).unwrap_err().to_string(),
        _ => montecarlo::Scenario::from_toml(text).unwrap_err().to_string(),
    }
}

#[test]
fn errors_name_the_line_and_the_key_or_the_numbers_that_contradict_each_other() {
    let cases = std::fs::read_to_string(REFUSED).unwrap();
    for case in cases.split("\n== ").skip(1) {
        let (title, body) = case.split_once('\n').unwrap_or((case, ""));
        let mut parts = title.split(" | ");
        let head = parts.next().unwrap();
        let (kind, change) = head.split_once(": ").unwrap_or((head, ""));
        let text = change.split_once(" -> ").map_or_else(
            || body.to_owned(),
            |(from, to)| {
                assert!(bundled(kind).contains(from), "{title}");
                bundled(kind).replace(from, to)
            },
        );
        let message = refusal(kind, &text);
        for part in parts {
            assert!(message.contains(part), "{title}: {message} lacks {part}");
        }
    }
}
