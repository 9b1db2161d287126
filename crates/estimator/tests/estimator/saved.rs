//! Saved states: a filter that is restored elsewhere goes on bit for bit, and bytes that are no state are refused.

use posebridge_estimator::{FILTERS, Filter, FilterCommand, FilterConfig, FilterEntry, Params};
use posebridge_telemetry::{
    Celsius, FusionOutcome, Observation, ObservationKind, OnlineCalibration, SensorId, Timestamp,
};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use crate::support::any::{learning_everything, without_learning};
use crate::support::filters::{start, state_text};
use crate::support::simulation::{
    CAMERA_10_HZ, Camera, Carry, SimulatedSensors, add, add_accelerometers, drive_carried_lap,
};

/// A lap of the square with every sensor there is, in the order of arrival: late fixes, and a thermometer that was warmed. The robot is
/// carried on the way, so that its wheels slip.
fn everything() -> Vec<Observation> {
    let carry = Carry { from: 160, steps: 20, by: (0.4, 0.3, 1.2) };
    let mut drive = drive_carried_lap(Some(Camera { outliers: 0.02, ..CAMERA_10_HZ }), &carry, 4);
    let mut sensors = SimulatedSensors::new(&without_learning(), 9);
    add(&mut drive, SensorId::LANDMARKS, 8, |_, truth| sensors.landmarks(truth));
    add(&mut drive, SensorId::BEACONS, 6, |_, truth| sensors.beacons(truth, &[(0.0, 0.0); 4]));
    add(&mut drive, SensorId::RANGE, 3, |_, truth| sensors.wall(truth));
    add(&mut drive, SensorId::COMPASS, 5, |_, truth| sensors.compass(truth));
    add_accelerometers(&mut drive, &mut sensors);
    add(&mut drive, SensorId::THERMOMETER, 2, |step, _| {
        let warmed_k = if step > 300 { 30.0 * (1.0 - (-0.003 * (step - 300) as f64).exp()) } else { 0.0 };
        vec![ObservationKind::Temperature(Celsius(20.0 + warmed_k + 0.01 * (step % 3) as f64))]
    });
    drive.observations()
}

/// What a filter makes of some observations, in enough digits to distinguish any two numbers, and what it is afterwards.
fn continued(filter: &mut dyn Filter, observations: &[Observation]) -> (Vec<String>, Vec<u8>) {
    let records = observations.iter().map(|observation| {
        let record = filter.observe(observation);
        let latest = filter.latest_time().unwrap_or(Timestamp::ZERO);
        format!("{record:?} {:?} {:?}", filter.estimate_at(latest), filter.scalar_at(latest))
    });
    (records.collect(), filter.save())
}

fn restored(entry: &FilterEntry, config: &FilterConfig, saved: &[u8]) -> Box<dyn Filter> {
    let mut filter = (entry.build)(config);
    filter.restore(saved).unwrap_or_else(|error| panic!("{}: {error}", entry.name));
    filter
}

/// Commands come on the way, so that some states do not follow from the observations alone.
fn interrupt(filter: &mut dyn Filter, config: &mut FilterConfig, index: usize) {
    let params = Params { gate_probability: 0.98, ..Params::default() };
    if index == 2_000 && filter.apply_command(&FilterCommand::SetParams(params)) == FusionOutcome::Accepted {
        config.params = params;
    }
    if index == 2_400 {
        filter.apply_command(&FilterCommand::SetOnlineCalibration(OnlineCalibration::Frozen));
    }
    if index == 3_000 {
        filter.set_pose(&start(1.0, 1.0, 0.3));
    }
}

/// Two filters are given the same from the beginning, and one of them is replaced by its restored state now and then.
#[test]
fn a_filter_that_is_restored_goes_on_as_if_it_had_never_been_left() {
    let observations = everything();
    println!("bytes of a saved state, 20 Hz with every sensor");
    for config in [without_learning(), learning_everything()] {
        for entry in FILTERS {
            let (mut stays, mut goes) = ((entry.build)(&config), (entry.build)(&config));
            let (mut config, mut sizes) = (config.clone(), Vec::new());
            for (index, observation) in observations.iter().enumerate() {
                for filter in [&mut stays, &mut goes] {
                    interrupt(&mut **filter, &mut config, index);
                }
                if index % 97 == 1 || [2_010, 2_410, 3_005].contains(&index) {
                    let saved = goes.save();
                    sizes.push(saved.len());
                    goes = restored(entry, &config, &saved);
                }
                let (expected, found) = (stays.observe(observation), goes.observe(observation));
                assert_eq!(format!("{expected:?}"), format!("{found:?}"), "{} at {index}", entry.name);
                if index % 50 == 0 {
                    assert_eq!(state_text(&*stays), state_text(&*goes), "{} at {index}", entry.name);
                }
            }
            assert!(stays.save() == goes.save(), "{}", entry.name);
            println!("{:24} {} to {}", entry.name, sizes.iter().min().unwrap(), sizes.iter().max().unwrap());
        }
    }
}

#[test]
fn a_clock_that_restarted_is_restored_as_well() {
    let observations = everything();
    let config = without_learning();
    for entry in FILTERS {
        let (mut stays, mut goes) = ((entry.build)(&config), (entry.build)(&config));
        for filter in [&mut stays, &mut goes] {
            continued(&mut **filter, &observations[..900]);
            filter.restart_clock();
        }
        goes = restored(entry, &config, &goes.save());
        let later = &observations[..600];
        assert!(continued(&mut *stays, later) == continued(&mut *goes, later), "{}", entry.name);
    }
}

/// Every byte of a state is changed, and the state is cut off anywhere: what is refused changes nothing, and what is not can be used.
#[test]
fn damaged_states_neither_panic_nor_change_a_filter_that_refuses_them() {
    let observations = everything();
    let mut random = Pcg64::seed_from_u64(7);
    let mut config = without_learning();
    config.params.history_s = 0.5;
    for entry in FILTERS {
        let mut filter = (entry.build)(&config);
        continued(&mut *filter, &observations[..250]);
        let saved = filter.save();
        let before = state_text(&*filter);
        let later = &observations[250..262];
        let mut refused = 0;
        let step = (saved.len() / 4_000).max(1);
        for index in (0..saved.len()).step_by(step) {
            let mut damaged = saved.clone();
            damaged[index] = match random.random_range(0..4) {
                0 => 0xFF,
                1 => damaged[index] ^ 0x80,
                2 => damaged[index].wrapping_add(1),
                _ => random.random(),
            };
            let mut target = (entry.build)(&config);
            if target.restore(&damaged).is_ok() {
                continued(&mut *target, later);
            } else {
                refused += 1;
            }
            if index % 16 == 0 {
                assert!(filter.restore(&saved[..index]).is_err(), "{}: cut at {index}", entry.name);
            }
        }
        assert_eq!(state_text(&*filter), before, "{}", entry.name);
        println!("{:24} {refused} of {} damaged states refused", entry.name, saved.len() / step);
    }
}
