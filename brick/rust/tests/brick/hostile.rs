//! What a link can do to bytes: cuts, losses, noise. All receivers must come to the same result.

use posebridge_brick::Receiver;

use crate::support::{answers, c_driver, folder, hex, python_driver, rust_answer, unhex, vectors};

/// Estimates and questions, as the vector file has them, one behind the other: frames, and what comes of each.
fn conversation() -> Vec<(Vec<u8>, String)> {
    let whole = vectors().into_iter().filter(|vector| {
        let is_one = vector.command.starts_with("receive 0 1 1 fd34");
        is_one && vector.command.len() == "receive 0 1 1 ".len() + 2 * 64 && vector.expected.starts_with("pose")
    });
    let frames: Vec<(Vec<u8>, String)> =
        whole.map(|vector| (unhex(&vector.command["receive 0 1 1 ".len()..]), vector.expected)).collect();
    assert!(frames.len() >= 3, "the vector file has no whole estimates");
    frames
}

fn command(bytes: &[u8]) -> String {
    format!("receive 0 1 1 {}", hex(bytes))
}

/// xorshift64: a fixed sequence of numbers without a dependency.
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }
}

/// Asks all three and holds them to each other.
fn agree(commands: &[String], name: &str) {
    let c = answers(&mut c_driver(&folder(name)), commands);
    let python = answers(&mut python_driver(), commands);
    for ((command, c), python) in commands.iter().zip(c).zip(python) {
        let rust = rust_answer(command);
        assert_eq!(c, rust, "C: {command}");
        assert_eq!(python, rust, "Python: {command}");
    }
}

#[test]
fn a_lost_byte_costs_the_frame_that_it_was_in_and_no_other() {
    let frames = conversation();
    let stream: Vec<u8> = frames.iter().flat_map(|(frame, _)| frame.clone()).collect();
    let mut commands = Vec::new();
    for lost in 0..stream.len() {
        let mut damaged = stream.clone();
        damaged.remove(lost);
        let mut end = 0;
        let survivors: Vec<&str> = frames
            .iter()
            .filter(|(frame, _)| {
                end += frame.len();
                !(end - frame.len()..end).contains(&lost)
            })
            .map(|(_, result)| result.as_str())
            .collect();
        // The last frame has nothing behind it that would refute it; it is then not missed either.
        assert_eq!(rust_answer(&command(&damaged)), survivors.join(" "), "byte {lost}");
        commands.push(command(&damaged));
    }
    agree(&commands, "lost");
}

#[test]
fn a_flipped_bit_never_makes_another_estimate() {
    let frames = conversation();
    let (frame, result) = &frames[0];
    let mut commands = Vec::new();
    for place in 0..8 * frame.len() {
        let mut damaged = frame.clone();
        damaged[place / 8] ^= 1 << (place % 8);
        damaged.extend_from_slice(frame);
        // The flag of a signature is part of the checksum, like all that follows the start byte.
        assert_eq!(rust_answer(&command(&damaged)), *result, "bit {place}");
        commands.push(command(&damaged));
    }
    agree(&commands, "flipped");
}

#[test]
fn noise_of_likely_bytes_is_read_alike_by_all() {
    // Bytes that headers are made of are drawn often, and whole frames are strewn in.
    const LIKELY: &[u8] = &[0xFD, 0x34, 0x01, 0x00, 0x76, 0xA4, 0x6F, 0x12];
    let frames = conversation();
    let mut noise = Noise(20_261_121);
    let mut commands = Vec::new();
    for _ in 0..300 {
        let mut bytes = Vec::new();
        while bytes.len() < 400 {
            let draw = noise.next();
            match draw % 40 {
                0 => bytes.extend_from_slice(&frames[(draw >> 8) as usize % frames.len()].0),
                1..=30 => bytes.push(LIKELY[(draw >> 8) as usize % LIKELY.len()]),
                _ => bytes.push((draw >> 8) as u8),
            }
        }
        commands.push(command(&bytes));
    }
    agree(&commands, "noise");
}

#[test]
fn the_python_module_reads_the_same_in_chunks_of_any_size() {
    let stream: Vec<u8> = conversation().into_iter().flat_map(|(frame, _)| frame).collect();
    let expected = rust_answer(&command(&stream));
    let commands: Vec<String> =
        (1..=stream.len()).map(|chunk| format!("chunks {chunk} 0 1 1 {}", hex(&stream))).collect();
    for (answer, command) in answers(&mut python_driver(), &commands).iter().zip(&commands) {
        assert_eq!(*answer, expected, "{}", &command[..12]);
    }
}

#[test]
fn a_receiver_that_nobody_polls_forgets_the_oldest_and_goes_on() {
    let (frame, _) = &conversation()[0];
    let mut receiver = Receiver::new();
    for byte in [0xFD; 1_000] {
        receiver.push(byte);
    }
    for byte in frame {
        receiver.push(*byte);
    }
    assert!(receiver.poll().is_some());
    assert!(receiver.poll().is_none());
}
