//! The same bytes in every language, and those of a foreign implementation: brick/vectors.

use std::process::Command;

use crate::support::{Vector, answers, c_driver, folder, nxc_driver, python_driver, rust_answer, vectors};

/// Holds a driver to those vectors that it knows.
fn check(driver: &mut Command, knows: impl Fn(&Vector) -> bool) -> usize {
    let vectors: Vec<Vector> = vectors().into_iter().filter(knows).collect();
    let commands: Vec<String> = vectors.iter().map(|v| v.command.clone()).collect();
    for (vector, answer) in vectors.iter().zip(answers(driver, &commands)) {
        assert_eq!(answer, vector.expected, "{}", vector.command);
    }
    vectors.len()
}

#[test]
fn this_crate_makes_and_understands_the_foreign_bytes() {
    for vector in vectors() {
        assert_eq!(rust_answer(&vector.command), vector.expected, "{}", vector.command);
    }
}

#[test]
fn the_c_header_makes_and_understands_the_foreign_bytes() {
    let checked = check(&mut c_driver(&folder("vectors-c")), |_| true);
    assert_eq!(checked, vectors().len());
}

#[test]
fn the_micropython_module_makes_and_understands_the_foreign_bytes() {
    let checked = check(&mut python_driver(), |_| true);
    assert_eq!(checked, vectors().len());
}

/// An NXT has no receiver: the estimate comes by mailbox. Its sensors have no accelerations, its motors count always.
#[test]
fn the_encoder_of_the_nxc_program_makes_the_foreign_bytes() {
    let sends = ["heartbeat", "wheel_ticks", "inertial"];
    let checked = check(&mut nxc_driver(&folder("vectors-nxc")), |vector| {
        sends.contains(&vector.command.split(' ').next().unwrap())
    });
    assert_eq!(checked, 4 + 9 + 7);
}

#[test]
fn thousandths_without_floating_point_are_those_with_it() {
    let numbers = [
        0.0,
        -0.0,
        0.0005,
        0.001,
        -0.001,
        1.0,
        -1.0,
        1.2345,
        -3.021_5,
        123.456,
        2_097_151.0,
        1e-30,
        16_777.2,
        -98_765.43,
    ];
    let commands: Vec<String> = numbers.iter().map(|number: &f32| format!("milli {:08x}", number.to_bits())).collect();
    let found = answers(&mut c_driver(&folder("milli")), &commands);
    for (number, found) in numbers.iter().zip(found) {
        let exact = (f64::from(*number) * 1_000.0) as i64;
        assert_eq!(found, exact.to_string(), "{number}");
    }
    let beyond = ["7f7fffff", "ff7fffff", "4f000000"].map(|bits| format!("milli {bits}"));
    let saturated = answers(&mut c_driver(&folder("milli")), &beyond);
    assert_eq!(saturated, ["2147483647", "-2147483647", "2147483647"]);
}
