//! The exchanges of tests/data/lego_bricks.txt, which describes its format.

use posebridge_sim::scenario::Personality;
use posebridge_sim::{Scenario, Simulation};

const EXCHANGES: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/lego_bricks.txt");

/// What comes within `millis`, and when, in milliseconds from here.
fn listen(simulation: &mut Simulation, millis: usize) -> Vec<(usize, Vec<u8>)> {
    let mut received = Vec::new();
    for at in 1..=millis {
        simulation.step();
        received.extend(std::iter::from_fn(|| simulation.poll()).map(|bytes| (at, bytes)));
    }
    received
}

/// A brick without a camera, and how long an answer of it is waited for.
fn brick(personality: &str, settings: &str) -> (Simulation, usize) {
    let mut settings = settings.replace("scenario ", "");
    if !settings.contains("brick.program = ") {
        settings.push_str("\nbrick.program = \"none\"");
    }
    let (personality, reply_timeout_ms) =
        if personality == "nxt" { (Personality::Nxt, 60) } else { (Personality::Ev3, 300) };
    let mut scenario = Scenario::from_toml(&settings).unwrap().with_personality(personality);
    scenario.camera.is_present = false;
    (Simulation::new(scenario), reply_timeout_ms)
}

fn with_length(telegram: &[u8]) -> Vec<u8> {
    [&(telegram.len() as u16).to_le_bytes()[..], telegram].concat()
}

fn telegram(line: &str) -> Vec<u8> {
    let bytes = line.split_whitespace().flat_map(|token| {
        let (byte, count) = token.split_once('*').unwrap_or((token, "1"));
        match token.strip_prefix('"') {
            Some(text) => text.trim_end_matches('"').as_bytes().to_vec(),
            None => vec![u8::from_str_radix(byte, 16).unwrap(); count.parse().unwrap()],
        }
    });
    bytes.collect()
}

fn assert_matches(pattern: &str, at: usize, answer: &[u8], context: &str) {
    let mut rest = answer;
    for token in pattern.split_whitespace() {
        if token == ".." {
            return;
        } else if let Some(millis) = token.strip_prefix('@') {
            assert_eq!(at, millis.parse::<usize>().unwrap(), "{context}");
        } else if token.starts_with('?') {
            let count = token.split_once('*').map_or(1, |(_, count)| count.parse().unwrap());
            rest = &rest[count..];
        } else if let Some((kind, range)) = token.split_once(':') {
            let (bytes, tail) = rest.split_at(if kind == "u16" { 2 } else { 4 });
            let value = match kind {
                "u16" => f64::from(u16::from_le_bytes(bytes.try_into().unwrap())),
                "i32" => f64::from(i32::from_le_bytes(bytes.try_into().unwrap())),
                _ => f64::from(f32::from_le_bytes(bytes.try_into().unwrap())),
            };
            let (low, high) = range.split_once("..").unwrap();
            assert!(
                low.parse::<f64>().unwrap() <= value && value <= high.parse().unwrap(),
                "{token}: {value}, {context}"
            );
            rest = tail;
        } else {
            let expected = telegram(token);
            let (found, tail) = rest.split_at(expected.len());
            assert_eq!(found, expected, "{context}");
            rest = tail;
        }
    }
    assert_eq!(rest, [0_u8; 0], "{context}");
}

fn follow(case: &str) {
    let (title, lines) = case.split_once('\n').unwrap();
    let lines = lines.lines().filter(|line| !line.is_empty() && !line.starts_with('#'));
    let (settings, steps): (Vec<&str>, Vec<&str>) = lines.partition(|line| line.starts_with("scenario "));
    let (mut simulation, reply_timeout_ms) = brick(&title[..3], &settings.join("\n"));
    let mut steps = steps.into_iter().peekable();
    while let Some(step) = steps.next() {
        let (word, rest) = step.split_once(' ').unwrap_or((step, ""));
        match word {
            "&" => simulation.receive(&with_length(&telegram(rest))),
            ">" | "~" => {
                let bytes = telegram(rest);
                simulation.receive(&if word == ">" { with_length(&bytes) } else { bytes });
                let received = listen(&mut simulation, reply_timeout_ms);
                let expected: Vec<&str> = std::iter::from_fn(|| steps.next_if(|step| step.starts_with("< "))).collect();
                assert_eq!(received.len(), expected.len(), "{title}: {step}: {received:02x?}");
                for ((at, bytes), pattern) in received.iter().zip(expected) {
                    let context = format!("{title}: {step}: {bytes:02x?} after {at} ms, expected {pattern}");
                    let answer = &bytes[if word == ">" { 2 } else { 0 }..];
                    assert!(word == "~" || *bytes == with_length(answer), "{context}");
                    assert_matches(&pattern[2..], *at, answer, &context);
                }
            }
            "wait" => assert_eq!(listen(&mut simulation, rest.parse().unwrap()), [], "{title}"),
            "restart" => simulation.restart_brick(),
            "reopen" => simulation.reopen_link(),
            "estimate" => {
                let [estimate] = simulation.received_estimates() else { panic!("not one estimate") };
                assert_eq!((estimate.estimate_time.as_micros(), estimate.pose.x.0), (5_100_000, 1.5));
                assert_eq!(simulation.truth().last().unwrap().onboard_estimate.x.0, 1.5);
            }
            _ => panic!("{title}: {step} is no step"),
        }
    }
}

#[test]
fn every_exchange_with_a_lego_brick_goes_as_it_is_written() {
    let exchanges = std::fs::read_to_string(EXCHANGES).unwrap();
    exchanges.split("\n== ").skip(1).for_each(follow);
}
